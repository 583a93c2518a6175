//! The battery pack.

use serde::{Deserialize, Serialize};

use super::table::Bound::Number;
use super::table::Vary::{Fixed, Plus, Times, Within};
use super::table::{Row, row};

/// A 2S lithium-ion pack.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pack {
    /// Charge of a full pack, ampere hours.
    pub capacity_ah: f32,
    /// Cells, protection circuit, switch and leads together, ohms.
    pub internal_ohm: f32,
    /// What everything but the motors draws, amperes.
    pub quiescent_a: f32,
    /// Share of the capacity at the start, 0 to 1.
    pub charge: f32,
    /// Terminal voltage below which the microcontroller resets, volts.
    pub brown_out_v: f32,
}

impl Default for Pack {
    fn default() -> Self {
        Self {
            capacity_ah: 2.0,
            internal_ohm: 0.18,
            quiescent_a: 0.15,
            charge: 0.95,
            brown_out_v: 4.5,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        pack.capacity_ah,
        "Ah",
        Number(0.001),
        Number(100.0),
        Times(0.05),
        Times(0.2),
        "charge of a full pack",
        "print on the cells"
    ),
    row!(
        pack.internal_ohm,
        "Ω",
        Number(0.0),
        Number(2.0),
        Times(0.1),
        Times(0.5),
        "cells, protection circuit, switch and leads together",
        "estimate: 2 × 50 mΩ cells, 40 mΩ protection, 40 mΩ leads and switch"
    ),
    row!(
        pack.quiescent_a,
        "A",
        Number(0.0),
        Number(2.0),
        Times(0.1),
        Times(0.3),
        "what everything but the motors draws",
        "ESP32 data sheet: 80 mA to 180 mA with the radio on"
    ),
    row!(
        pack.charge,
        "1",
        Number(0.0),
        Number(1.0),
        Plus(0.05),
        Within(0.3, 1.0),
        "share of the capacity at the start",
        "choice: charged, but not just now"
    ),
    row!(
        pack.brown_out_v,
        "V",
        Number(0.0),
        Number(8.0),
        Fixed,
        Times(0.05),
        "terminal voltage below which the microcontroller resets",
        "estimate: 3.3 V at the chip and the regulator's drop of 1.2 V"
    ),
];
