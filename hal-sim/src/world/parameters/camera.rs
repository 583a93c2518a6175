//! Where the camera sits and how wide it sees.

use serde::{Deserialize, Serialize};

use super::table::Bound::{Number, Of};
use super::table::Vary::{Plus, Times};
use super::table::{Row, row};

/// The camera on a robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Camera {
    /// Distance from the robot's centre to the lens, metres.
    pub forward_m: f32,
    /// Height of the lens above the floor, metres.
    pub height_m: f32,
    /// How far it looks down, radians.
    pub pitch: f32,
    /// Half the horizontal field of view, radians.
    pub half_view: f32,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            forward_m: 0.0,
            height_m: 0.07,
            pitch: 0.0,
            // 30°.
            half_view: core::f32::consts::FRAC_PI_6,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        camera.forward_m,
        "m",
        Number(0.0),
        Of("chassis.radius_m"),
        Plus(0.003),
        Plus(0.01),
        "distance from the robot's centre to the lens",
        "choice: the mast in the middle of the chassis"
    ),
    row!(
        camera.height_m,
        "m",
        Number(0.01),
        Number(0.5),
        Plus(0.003),
        Plus(0.01),
        "height of the lens above the floor",
        "choice"
    ),
    row!(
        camera.pitch,
        "rad",
        Number(-0.7),
        Number(0.7),
        Plus(0.02),
        Plus(0.1),
        "how far the camera looks down",
        "choice"
    ),
    row!(
        camera.half_view,
        "rad",
        Number(0.1),
        Number(0.7),
        Times(0.02),
        Times(0.1),
        "half the horizontal field of view",
        "OV2640 modules with the usual lens: 60° and more"
    ),
];
