//! By what a swarm is measured.

use serde::{Deserialize, Serialize};

/// The distances and the time that metrics of a swarm go by.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(clippy::struct_field_names)] // the keys of a scenario file, which name their unit
pub struct Measure {
    /// Robots whose middles are no farther apart than this belong to one cluster, metres.
    pub near_m: f32,
    /// The distance that neighbours in a lattice are to keep, metres.
    pub spacing_m: f32,
    /// The last part of a run, over which a swarm is measured, seconds.
    pub window_s: f32,
}

impl Default for Measure {
    /// What `disperse` keeps, what `formation` keeps, and a minute.
    fn default() -> Self {
        Self {
            near_m: 1.2,
            spacing_m: 0.8,
            window_s: 60.0,
        }
    }
}

impl Measure {
    pub(super) fn is_usual(&self) -> bool {
        *self == Self::default()
    }

    /// The first key out of range, and the rule.
    pub(super) fn validate(&self) -> Result<(), (&'static str, String)> {
        for (key, value, low, high) in [
            ("near_m", self.near_m, 0.01, 10.0),
            ("spacing_m", self.spacing_m, 0.01, 5.0),
            ("window_s", self.window_s, 1.0, 3_600.0),
        ] {
            if !(low..=high).contains(&value) {
                return Err((key, format!("must be {low} to {high}, not {value}")));
            }
        }
        Ok(())
    }
}
