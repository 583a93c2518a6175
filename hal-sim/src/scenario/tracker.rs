//! The overhead camera of a scenario.

use serde::{Deserialize, Serialize};

/// A camera above the arena that tells every robot where it is, on `{fleet}/pose/{id}`.
///
/// Robots have no other way to know where they booted, and drift from there. Without a network
/// nothing is told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tracker {
    /// Whether there is one.
    pub on: bool,
    /// Fixes for each robot in a second, spread evenly: 0.1 to 50.
    pub rate_hz: f32,
    /// Standard deviation of the position along each axis, metres.
    pub sigma_m: f32,
    /// Standard deviation of the heading, radians.
    pub sigma_rad: f32,
}

impl Default for Tracker {
    fn default() -> Self {
        Self {
            on: true,
            rate_hz: 2.0,
            sigma_m: 0.01,
            sigma_rad: 0.02,
        }
    }
}

impl Tracker {
    /// Checks every value.
    ///
    /// # Errors
    /// The name of the field that is out of range, and its range.
    pub fn validate(&self) -> Result<(), &'static str> {
        if !(0.1..=50.0).contains(&self.rate_hz) {
            Err("rate_hz must be 0.1 to 50")
        } else if !(0.0..=1.0).contains(&self.sigma_m) {
            Err("sigma_m must be 0 to 1")
        } else if !(0.0..=1.0).contains(&self.sigma_rad) {
            Err("sigma_rad must be 0 to 1")
        } else {
            Ok(())
        }
    }
}
