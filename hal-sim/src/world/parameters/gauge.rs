//! The way from the pack to the converter.

use serde::{Deserialize, Serialize};

use super::table::Bound::Number;
use super::table::Vary::{Fixed, Times, Within};
use super::table::{Row, row};

/// The way from the pack to the converter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Gauge {
    /// Resistor from the pack to the pin, ohms.
    pub upper_ohm: f32,
    /// Resistor from the pin to ground, ohms.
    pub lower_ohm: f32,
    /// Standard deviation of one conversion at the pin, millivolts.
    pub noise_mv: f32,
    /// One step of the converter, millivolts.
    pub step_mv: f32,
}

impl Default for Gauge {
    fn default() -> Self {
        Self {
            upper_ohm: 100_000.0,
            lower_ohm: 47_000.0,
            noise_mv: 3.0,
            // 3.1 V in 12 bits.
            step_mv: 0.757,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        gauge.upper_ohm,
        "Ω",
        Number(0.0),
        Number(1e7),
        Times(0.01),
        Times(0.02),
        "resistor from the pack to the pin",
        "choice; parts of 1 %"
    ),
    row!(
        gauge.lower_ohm,
        "Ω",
        Number(1.0),
        Number(1e7),
        Times(0.01),
        Times(0.02),
        "resistor from the pin to ground",
        "choice; parts of 1 %"
    ),
    row!(
        gauge.noise_mv,
        "mV",
        Number(0.0),
        Number(500.0),
        Times(0.25),
        Within(0.0, 12.0),
        "standard deviation of one conversion at the pin",
        "estimate"
    ),
    row!(
        gauge.step_mv,
        "mV",
        Number(0.001),
        Number(200.0),
        Fixed,
        Within(0.5, 13.0),
        "one step of the converter",
        "ESP32-S3 data sheet: 12 bits, and 3.1 V at 12 dB"
    ),
];
