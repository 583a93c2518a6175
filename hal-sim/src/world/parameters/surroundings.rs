//! Air and electronics.

use serde::{Deserialize, Serialize};

use super::table::Bound::Number;
use super::table::Vary::{Fixed, Plus, Within};
use super::table::{Row, row};

/// Air and electronics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Surroundings {
    /// Temperature of the air, degrees Celsius.
    pub air_c: f32,
    /// Longest time between two feedings of the watchdog, milliseconds; 0 switches it off.
    pub watchdog_ms: u32,
    /// Erase blocks of 4 KiB in each robot's parameter flash.
    pub flash_sectors: u16,
}

impl Default for Surroundings {
    fn default() -> Self {
        Self {
            air_c: 22.0,
            watchdog_ms: 1_000,
            flash_sectors: 4,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        surroundings.air_c,
        "°C",
        Number(-40.0),
        Number(85.0),
        Plus(3.0),
        Within(5.0, 38.0),
        "temperature of the air",
        "choice: a heated room"
    ),
    row!(
        surroundings.watchdog_ms,
        "ms",
        Number(0.0),
        Number(3_600_000.0),
        Fixed,
        Fixed,
        "longest time between two feedings of the watchdog; 0 switches it off",
        "choice, as on the boards"
    ),
    row!(
        surroundings.flash_sectors,
        "1",
        Number(2.0),
        Number(64.0),
        Fixed,
        Fixed,
        "erase blocks of 4 KiB in each robot's parameter flash",
        "partition table of the boards"
    ),
];
