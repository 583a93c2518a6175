//! What the world looks like, and what a camera makes of it.

use serde::{Deserialize, Serialize};

use super::table::Bound::Number;
use super::table::Vary::{Plus, Times, Within};
use super::table::{Row, row};

/// Paint, light and the imperfections of a camera. Nominal: plain paint and a perfect camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Look {
    /// Which textures, colours and light are drawn; matters where [`Self::variety`] is not 0.
    pub seed: u32,
    /// How far textures, colours and light differ from the plain ones, 0 to 1.
    pub variety: f32,
    /// Barrel distortion: a point that a straight lens shows at r focal lengths from the middle
    /// is where r = s (1 + distortion · s²) at s focal lengths.
    pub distortion: f32,
    /// How long the shutter is open, milliseconds: what moves meanwhile is blurred.
    pub shutter_ms: f32,
    /// What every level is multiplied by.
    pub exposure: f32,
    /// Error of the white balance: red is multiplied by 1 + warmth, blue by 1 − warmth.
    pub warmth: f32,
    /// Share of light that is missing in the corners.
    pub vignette: f32,
    /// Noise of light: standard deviation in grey levels over the square root of the level.
    pub shot_noise: f32,
    /// Noise of the sensor: standard deviation in grey levels.
    pub read_noise: f32,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            seed: 0,
            variety: 0.0,
            distortion: 0.0,
            shutter_ms: 0.0,
            exposure: 1.0,
            warmth: 0.0,
            vignette: 0.0,
            shot_noise: 0.0,
            read_noise: 0.0,
        }
    }
}

/// Rows of the table.
pub(super) const ROWS: &[Row] = &[
    row!(
        look.seed,
        "1",
        Number(0.0),
        Number(16_777_215.0),
        Within(0.0, 16_777_215.0),
        Within(0.0, 16_777_215.0),
        "which textures, colours and light are drawn",
        "choice"
    ),
    row!(
        look.variety,
        "1",
        Number(0.0),
        Number(1.0),
        Within(0.3, 0.7),
        Within(0.3, 1.0),
        "how far textures, colours and light differ from plain ones",
        "choice: plain paint"
    ),
    row!(
        look.distortion,
        "1",
        Number(0.0),
        Number(0.5),
        Within(0.0, 0.1),
        Within(0.0, 0.3),
        "barrel distortion of the lens",
        "choice: a straight lens; small lenses of 60° have 0.1 to 0.3"
    ),
    row!(
        look.shutter_ms,
        "ms",
        Number(0.0),
        Number(100.0),
        Within(0.0, 10.0),
        Within(0.0, 30.0),
        "how long the shutter is open",
        "choice: no blur; indoors at 30 frames a second up to 33 ms"
    ),
    row!(
        look.exposure,
        "1",
        Number(0.1),
        Number(8.0),
        Times(0.15),
        Times(0.4),
        "what every level is multiplied by",
        "choice: exposed right"
    ),
    row!(
        look.warmth,
        "1",
        Number(-0.5),
        Number(0.5),
        Plus(0.06),
        Plus(0.15),
        "error of the white balance, more red and less blue",
        "choice: white is white"
    ),
    row!(
        look.vignette,
        "1",
        Number(0.0),
        Number(0.9),
        Within(0.0, 0.2),
        Within(0.0, 0.5),
        "share of light missing in the corners",
        "choice: none; cos⁴ 35° is 0.55"
    ),
    row!(
        look.shot_noise,
        "1",
        Number(0.0),
        Number(8.0),
        Within(0.0, 0.3),
        Within(0.0, 0.6),
        "noise of light over the square root of the level",
        "choice: none"
    ),
    row!(
        look.read_noise,
        "levels",
        Number(0.0),
        Number(64.0),
        Within(0.0, 2.0),
        Within(0.0, 5.0),
        "noise of the sensor",
        "choice: none"
    ),
];
