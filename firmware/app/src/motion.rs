//! From wanted motion to duty, and from duty to where the robot should be by now.

pub mod angle;
#[cfg(test)]
mod correction_tests;
mod odometry;
mod radians;
mod ramp;
#[cfg(test)]
mod tests;

use crate::config::Geometry;

pub use odometry::{Correction, Odometry};
pub(crate) use radians::{sin_cos, wrap};
pub use ramp::{DEAD_TIME, Ramp};

/// Motion of the whole robot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Twist {
    /// Forward, in metres per second.
    pub v: f32,
    /// Counter-clockwise, in radians per second.
    pub w: f32,
}

impl Twist {
    /// Standing.
    pub const ZERO: Self = Self { v: 0.0, w: 0.0 };
}

/// Speeds of the left and right wheel for `twist`, in metres per second.
///
/// When a wheel would be faster than `limit`, both are slowed by the same factor: the robot is
/// slower then, but on the curve it was asked to drive. Anything not finite stands still.
pub fn wheel_speeds(twist: Twist, geometry: &Geometry, limit: f32) -> [f32; 2] {
    let turn = twist.w * geometry.wheel_base_m * 0.5;
    let [left, right] = [twist.v - turn, twist.v + turn];
    let fastest = libm::fabsf(left).max(libm::fabsf(right));
    if !fastest.is_finite() {
        return [0.0; 2];
    }
    let scale = if fastest > limit {
        limit / fastest
    } else {
        1.0
    };
    [left * scale, right * scale]
}

/// Duty at which a wheel settles at `speed`, −1 to 1: the inverse of [`settled_speed`].
pub fn duty_for(speed: f32, geometry: &Geometry) -> f32 {
    /// Slower than this a robot does not visibly move.
    const STANDING: f32 = 1e-3;
    let share = libm::fabsf(speed) / geometry.top_speed_mps;
    if share < STANDING || !share.is_finite() {
        return 0.0;
    }
    let duty = geometry.stiction_duty + (1.0 - geometry.stiction_duty) * share.min(1.0);
    libm::copysignf(duty, speed)
}

/// Speed a wheel settles at under `duty`: nothing below stiction, then in proportion.
pub fn settled_speed(duty: f32, geometry: &Geometry) -> f32 {
    let above = libm::fabsf(duty) - geometry.stiction_duty;
    if above <= 0.0 {
        return 0.0;
    }
    let speed = above / (1.0 - geometry.stiction_duty) * geometry.top_speed_mps;
    libm::copysignf(speed, duty)
}
