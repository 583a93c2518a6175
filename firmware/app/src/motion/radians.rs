//! Angles in radians, as estimates and messages have them. [`angle`](super::angle) has them in whole numbers.

use core::f32::consts::PI;

/// The same angle, above −π and up to π.
pub(crate) fn wrap(angle: f32) -> f32 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let angle = libm::remainderf(angle, 2.0 * PI);
    if angle <= -PI { PI } else { angle }
}
