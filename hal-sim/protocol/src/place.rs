//! Where robots are put.

use crawler_protocol::MAX_COORDINATE;

/// Where a robot is put.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Metres along the x axis, within ±[`MAX_COORDINATE`].
    pub x: f32,
    /// Metres along the y axis, within ±[`MAX_COORDINATE`].
    pub y: f32,
    /// Heading in radians, counter-clockwise from the x axis, within ±[`Place::MAX_THETA`].
    pub theta: f32,
}

impl Place {
    /// Largest heading either way, in radians.
    pub const MAX_THETA: f32 = 7.0;

    pub(crate) fn is_sound(&self) -> bool {
        self.x.abs() <= MAX_COORDINATE
            && self.y.abs() <= MAX_COORDINATE
            && self.theta.abs() <= Self::MAX_THETA
    }
}
