//! Dead reckoning from the duties, since the wheels have no encoders.

use core::f32::consts::PI;

use crawler_hal::Duration;
use crawler_protocol::Pose;

use super::settled_speed;
use crate::config::Geometry;

/// Growth of sigma per metre driven: load, floor and charge change the speed under one duty by
/// about a tenth.
const SIGMA_PER_M: f32 = 0.10;
/// Growth of sigma per radian turned: small wheels slip when turning in place.
const SIGMA_PER_RAD: f32 = 0.02;
/// Beyond this the pose says nothing anyway, and the number stays readable.
const SIGMA_MAX: f32 = 1_000.0;
/// Slower than this a wheel stands, in metres per second.
const STANDING: f32 = 1e-4;

/// Where the robot should be, by the first-order model of its motors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odometry {
    pose: Pose,
    speeds: [f32; 2],
    /// `1 − exp(−dt/τ)` for the last `dt`: the period hardly ever changes.
    lag: (Duration, f32),
}

impl Default for Odometry {
    fn default() -> Self {
        Self {
            pose: Pose::default(),
            speeds: [0.0; 2],
            lag: (Duration::ZERO, 0.0),
        }
    }
}

impl Odometry {
    /// Where the robot should be.
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// Lets `dt` pass with `duties` on the wheels.
    ///
    /// Within the step the model is solved exactly; the path is taken as an arc through its
    /// middle heading, whose error is far below that of the model.
    pub fn advance(&mut self, duties: [f32; 2], dt: Duration, geometry: &Geometry) {
        let standing = |values: [f32; 2], limit| values.iter().all(|v| libm::fabsf(*v) <= limit);
        if standing(duties, geometry.stiction_duty) && standing(self.speeds, STANDING) {
            self.speeds = [0.0; 2];
            return;
        }
        let seconds = dt.as_secs_f32();
        if self.lag.0 != dt {
            let lag = 1.0 - libm::expf(-seconds / geometry.time_constant_s);
            self.lag = (dt, lag);
        }
        let lag = self.lag.1;
        let mut way = [0.0; 2];
        for ((way, speed), duty) in way.iter_mut().zip(&mut self.speeds).zip(duties) {
            let settled = settled_speed(duty, geometry);
            *way = settled * seconds + (*speed - settled) * geometry.time_constant_s * lag;
            *speed += (settled - *speed) * lag;
        }
        let [left, right] = way;
        self.travel((left + right) * 0.5, (right - left) / geometry.wheel_base_m);
    }

    fn travel(&mut self, forward: f32, turn: f32) {
        let heading = self.pose.theta + turn * 0.5;
        let pose = Pose {
            x: self.pose.x + forward * libm::cosf(heading),
            y: self.pose.y + forward * libm::sinf(heading),
            theta: wrap(self.pose.theta + turn),
            sigma: (self.pose.sigma
                + SIGMA_PER_M * libm::fabsf(forward)
                + SIGMA_PER_RAD * libm::fabsf(turn))
            .min(SIGMA_MAX),
        };
        if pose.x.is_finite() && pose.y.is_finite() && pose.theta.is_finite() {
            self.pose = pose;
        }
    }
}

/// The same angle within −π to π.
pub(crate) fn wrap(angle: f32) -> f32 {
    if (-PI..=PI).contains(&angle) {
        angle
    } else {
        libm::remainderf(angle, 2.0 * PI)
    }
}
