//! How much robots differ from each other.

use serde::{Deserialize, Serialize};

use super::table::Bound::Number;
use super::table::Vary::{Fixed, Times, Within};
use super::table::{Row, row};

/// How much robots differ, as standard deviations drawn once for each robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spread {
    /// Of what each motor makes of its voltage, as a share. All draws beyond three deviations are
    /// cut.
    pub motor: f32,
    /// Of the effective track, as a share: wheels that slip while turning.
    pub track: f32,
    /// Of the charge at the start, as a share of the capacity.
    pub charge: f32,
    /// Of each motor's dry friction, as a share.
    pub friction: f32,
    /// Of the mass, as a share.
    pub mass: f32,
    /// Of the pack's internal resistance, as a share.
    pub cells: f32,
    /// Of the error of the ranger's thermometer, degrees Celsius.
    pub thermometer_c: f32,
    /// Of the gain from the pack to the converter's number, as a share: resistors and reference.
    pub gauge_gain: f32,
    /// Of the converter's offset, millivolts at the pin.
    pub gauge_offset_mv: f32,
    /// Rangers begin to measure within so many milliseconds of each other: no two programs start
    /// at the same moment.
    pub ranger_start_ms: f32,
}

impl Default for Spread {
    fn default() -> Self {
        Self {
            motor: 0.01,
            track: 0.02,
            charge: 0.02,
            friction: 0.05,
            mass: 0.02,
            cells: 0.1,
            thermometer_c: 1.0,
            gauge_gain: 0.007,
            gauge_offset_mv: 5.0,
            ranger_start_ms: 80.0,
        }
    }
}

impl Spread {
    /// All robots alike.
    pub const NONE: Self = Self {
        motor: 0.0,
        track: 0.0,
        charge: 0.0,
        friction: 0.0,
        mass: 0.0,
        cells: 0.0,
        thermometer_c: 0.0,
        gauge_gain: 0.0,
        gauge_offset_mv: 0.0,
        ranger_start_ms: 0.0,
    };
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        spread.motor,
        "1",
        Number(0.0),
        Number(0.05),
        Times(0.2),
        Within(0.0, 0.03),
        "standard deviation of each motor's speed, as a share",
        "estimate"
    ),
    row!(
        spread.track,
        "1",
        Number(0.0),
        Number(0.1),
        Times(0.2),
        Within(0.0, 0.04),
        "standard deviation of the effective track, as a share",
        "estimate"
    ),
    row!(
        spread.charge,
        "1",
        Number(0.0),
        Number(0.5),
        Times(0.2),
        Within(0.0, 0.1),
        "standard deviation of the charge at the start, as a share of the capacity",
        "estimate"
    ),
    row!(
        spread.thermometer_c,
        "°C",
        Number(0.0),
        Number(5.0),
        Times(0.2),
        Within(0.0, 3.0),
        "standard deviation of the error of the ranger's thermometer",
        "estimate; the US-100 data sheet gives none"
    ),
    row!(
        spread.gauge_gain,
        "1",
        Number(0.0),
        Number(0.05),
        Times(0.2),
        Within(0.0, 0.02),
        "standard deviation of the gain from pack to converter, as a share",
        "choice: two resistors of 1 %, taken for 3 deviations, and the reference"
    ),
    row!(
        spread.gauge_offset_mv,
        "mV",
        Number(0.0),
        Number(50.0),
        Times(0.2),
        Within(0.0, 15.0),
        "standard deviation of the converter's offset at the pin",
        "estimate: a third of the ±15 mV or so that calibrated converters of this kind are off by"
    ),
    row!(
        spread.ranger_start_ms,
        "ms",
        Number(0.0),
        Number(1_000.0),
        Fixed,
        Fixed,
        "rangers begin to measure within so long of each other",
        "choice: one period of measuring"
    ),
    row!(
        spread.friction,
        "1",
        Number(0.0),
        Number(0.2),
        Times(0.2),
        Within(0.0, 0.15),
        "standard deviation of each motor's dry friction, as a share",
        "estimate"
    ),
    row!(
        spread.mass,
        "1",
        Number(0.0),
        Number(0.2),
        Times(0.2),
        Within(0.0, 0.1),
        "standard deviation of the mass, as a share",
        "estimate"
    ),
    row!(
        spread.cells,
        "1",
        Number(0.0),
        Number(0.3),
        Times(0.2),
        Within(0.0, 0.25),
        "standard deviation of the pack's internal resistance, as a share",
        "estimate"
    ),
];
