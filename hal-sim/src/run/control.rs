//! What controlling a world has in common, in real time and in virtual time.

use std::fmt;
use std::time::Duration as StdDuration;

use crawler_hal::Duration;

/// Slowest and fastest a world can be told to run, as multiples of real time.
const SPEED_RANGE: (f32, f32) = (0.01, 1_000.0);

/// How many times as fast as real time a world runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Factor(f64);

/// A world cannot run so many times as fast as real time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FactorError(f64);

impl fmt::Display for FactorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (least, most) = SPEED_RANGE;
        write!(f, "a speed factor is {least} to {most}, not {}", self.0)
    }
}

impl std::error::Error for FactorError {}

impl Factor {
    pub(crate) const REAL_TIME: Self = Self(1.0);

    pub(crate) fn new(factor: f64) -> Result<Self, FactorError> {
        let (least, most) = SPEED_RANGE;
        if (f64::from(least)..=f64::from(most)).contains(&factor) {
            Ok(Self(factor))
        } else {
            Err(FactorError(factor))
        }
    }

    pub(crate) const fn get(self) -> f64 {
        self.0
    }

    /// The virtual time that `real` time is, in whole microseconds.
    pub(crate) fn of(self, real: StdDuration) -> Duration {
        Duration::from_micros((real.as_secs_f64() * self.0 * 1e6) as u64)
    }
}
