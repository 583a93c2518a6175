//! Dead reckoning from the duties, since the wheels have no encoders, and its correction by
//! outside position references.
//!
//! The estimate is a position with one sigma for both axes and a heading with a sigma of its own;
//! what they have to do with each other is left out, but a vague heading makes the position vaguer
//! with every metre driven. A fix is weighed by the variances, each part on its own.
//!
//! No two motors are the same, so a robot that wants to drive straight on bends. How much is estimated along
//! with the heading, from what the fixes show of it: else the heading would always be late by the same, several degrees, which
//! is a corridor missed. (Larsen, Andersen, Ravn and Poulsen, "Location estimation for an autonomously guided vehicle using an
//! augmented Kalman filter to autocalibrate the odometry", FUSION 1998; here for the one error that matters.)

use core::f32::consts::PI;

use crawler_hal::Duration;
use crawler_protocol::Pose;

use super::{settled_speed, sin_cos, wrap};
use crate::config::Geometry;

/// Growth of sigma per metre driven: load, floor and charge change the speed under one duty by
/// about a tenth.
const SIGMA_PER_M: f32 = 0.10;
/// Growth of sigma per radian turned: small wheels slip when turning in place.
const SIGMA_PER_RAD: f32 = 0.02;
/// Growth of the heading's sigma per metre driven: a hundredth between two wheels 0.15 m apart is
/// 0.07 radians in a metre, and motors of one type differ by a little more.
const TURN_SIGMA_PER_M: f32 = 0.08;
/// Growth of the heading's sigma per radian turned.
const TURN_SIGMA_PER_RAD: f32 = 0.04;
/// How much a robot may bend that drives straight on, in radians per metre, one standard deviation: motors of one type differ
/// by a twentieth.
const BEND_SIGMA: f32 = 0.3;
/// It is never surer of that: load, floor and charge change it.
const BEND_SIGMA_LEAST: f32 = 0.03;
/// No robot bends more: a wheel would be a seventh slower than the other.
const BEND_MOST: f32 = 1.0;
/// Beyond this the pose says nothing anyway, and the number stays readable.
const SIGMA_MAX: f32 = 1_000.0;
/// A heading that may be anything: the deviation of a uniform distribution over the circle.
const TURN_SIGMA_MAX: f32 = 1.813_8;
/// Slower than this a wheel stands, in metres per second.
const STANDING: f32 = 1e-4;

/// A fix is taken for at least this uncertain, in metres: no camera is better.
const FIX_SIGMA_LEAST: f32 = 0.001;
/// A fix does not say how sure its heading is. A mark of 0.3 m between the points that are
/// located turns by about √2 × sigma ÷ 0.3 m.
const FIX_TURN_PER_M: f32 = 5.0;
/// The heading of a fix is taken for at least this uncertain, in radians.
const FIX_TURN_LEAST: f32 = 0.01;
/// Errors of successive fixes are not independent: however many there are, together they are at
/// most so much better than one.
const BEST_SHARE: f32 = 0.5;
/// A fix that is off by more than so many sigmas is doubted. By chance one in three thousand is
/// (two axes, normally distributed).
const GATE: f32 = 4.0;
/// So many doubted fixes in a row that agree with each other are right, and odometry is not.
const CONVINCING: u8 = 3;
/// How far doubted fixes may be from each other to agree, beyond their sigma and the way between
/// them, in metres and radians.
const AGREEMENT: [f32; 2] = [0.1, 0.3];

/// What a fix came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Correction {
    /// It moved the estimate, by its weight.
    Weighed,
    /// It is the estimate now: the first one, or one that others like it had announced.
    Adopted,
    /// It is too far from the estimate to be believed alone.
    Doubted,
    /// It is no pose.
    Refused,
}

/// Fixes that odometry contradicts, moved along with it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Doubt {
    pose: Pose,
    count: u8,
}

/// Where the robot should be, by the first-order model of its motors.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Odometry {
    pose: Pose,
    /// One standard deviation of the heading, in radians.
    turn_sigma: f32,
    speeds: [f32; 2],
    /// The last `dt`, its seconds, and `1 − exp(−dt/τ)`: the period hardly ever changes.
    lag: (Duration, f32, f32),
    /// Metres driven and radians turned since the last fix that was believed; `None` before the
    /// first one. A robot held up by a wall is off by just that.
    since_fix: Option<[f32; 2]>,
    bend: Bend,
    doubt: Option<Doubt>,
}

/// How much the robot turns for each metre that it should drive straight on.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Bend {
    /// Radians per metre, counter-clockwise.
    rate: f32,
    /// Its variance.
    variance: f32,
    /// Its covariance with the heading at the last fix.
    covariance: f32,
    /// Metres driven since then, forward less back.
    onward: f32,
}

impl Bend {
    const UNKNOWN: Self = Self {
        rate: 0.0,
        variance: BEND_SIGMA * BEND_SIGMA,
        covariance: 0.0,
        onward: 0.0,
    };

    /// Learns from a fix whose heading is `error` from the estimate, with the variance that both have together;
    /// `turn_gain` is the share by which the estimate is moved.
    fn learn(&mut self, error: f32, variance: f32, turn_gain: f32) {
        let covariance = self.covariance + self.onward * self.variance;
        let gain = covariance / variance;
        self.rate = (self.rate + gain * error).clamp(-BEND_MOST, BEND_MOST);
        let least = BEND_SIGMA_LEAST * BEND_SIGMA_LEAST;
        self.variance = (self.variance - gain * covariance).max(least);
        self.covariance = covariance * (1.0 - turn_gain);
        self.onward = 0.0;
    }

    /// The heading is another one, and has nothing to do with the way to it.
    const fn restart(&mut self) {
        self.covariance = 0.0;
        self.onward = 0.0;
    }
}

impl Default for Odometry {
    fn default() -> Self {
        Self {
            pose: Pose::default(),
            turn_sigma: 0.0,
            speeds: [0.0; 2],
            lag: (Duration::ZERO, 0.0, 0.0),
            since_fix: None,
            bend: Bend::UNKNOWN,
            doubt: None,
        }
    }
}

impl Odometry {
    /// Where the robot should be: in the frame of the fixes, and before the first of them in one
    /// that begins where the robot booted.
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// How much the robot turns for each metre that it should drive straight on, in radians counter-clockwise, as far as fixes
    /// have shown it.
    pub const fn bend(&self) -> f32 {
        self.bend.rate
    }

    /// One standard deviation of the heading, in radians.
    pub const fn turn_sigma(&self) -> f32 {
        self.turn_sigma
    }

    /// Whether it is in the frame of the fixes.
    pub const fn is_placed(&self) -> bool {
        self.since_fix.is_some()
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
        if self.lag.0 != dt {
            let seconds = dt.as_secs_f32();
            let lag = 1.0 - libm::expf(-seconds / geometry.time_constant_s);
            self.lag = (dt, seconds, lag);
        }
        let (_, seconds, lag) = self.lag;
        let mut way = [0.0; 2];
        for ((way, speed), duty) in way.iter_mut().zip(&mut self.speeds).zip(duties) {
            let settled = settled_speed(duty, geometry);
            *way = settled * seconds + (*speed - settled) * geometry.time_constant_s * lag;
            *speed += (settled - *speed) * lag;
        }
        let [left, right] = way;
        let forward = (left + right) * 0.5;
        let bent = self.bend.rate * forward;
        self.bend.onward += forward;
        self.travel(forward, (right - left) / geometry.wheel_base_m + bent);
    }

    /// Takes in a fix that was seen `age` ago.
    ///
    /// It is moved on by the present speeds for that long: what remains of the delay is at most
    /// `age` times the change of speed within it. Then
    ///
    /// * the first fix is adopted, because until then the frame is arbitrary;
    /// * one within four sigmas of the estimate and its own, and the way driven since the last
    ///   one, moves position and heading by the ratio of variances, and sigma shrinks; what it shows of how much the robot
    ///   bends is kept;
    /// * one beyond that is doubted and changes nothing. The third in a row that agrees with the
    ///   others is adopted: someone has carried the robot.
    ///
    /// Sigma grows only where a fix is adopted.
    pub fn correct(&mut self, fix: Pose, age: Duration, geometry: &Geometry) -> Correction {
        let finite = [fix.x, fix.y, fix.theta, fix.sigma]
            .iter()
            .all(|v| v.is_finite());
        if !finite || fix.sigma < 0.0 {
            return Correction::Refused;
        }
        let seconds = age.as_secs_f32();
        let [left, right] = self.speeds.map(|speed| speed * seconds);
        let turn = (right - left) / geometry.wheel_base_m;
        let fix = Pose {
            theta: wrap(fix.theta),
            sigma: fix.sigma.clamp(FIX_SIGMA_LEAST, SIGMA_MAX),
            ..fix
        };
        let fix = moved(fix, (left + right) * 0.5, turn);
        let fix_turn = (fix.sigma * FIX_TURN_PER_M).clamp(FIX_TURN_LEAST, TURN_SIGMA_MAX);
        let Some([driven, turned]) = self.since_fix else {
            return self.adopt(fix, fix_turn);
        };
        let off = offset(fix, self.pose);
        let within = is_near(off[0] - driven, self.pose.sigma, fix.sigma)
            && is_near(off[1] - turned, self.turn_sigma, fix_turn);
        if within {
            self.weigh(fix, fix_turn);
            return Correction::Weighed;
        }
        let agrees = |doubt: &Doubt| {
            let [way, turn] = offset(fix, doubt.pose);
            way <= AGREEMENT[0] + 2.0 * GATE * fix.sigma + driven
                && turn <= AGREEMENT[1] + 2.0 * GATE * fix_turn + turned
        };
        let count = match self.doubt.filter(agrees) {
            Some(doubt) => doubt.count.saturating_add(1),
            None => 1,
        };
        if count >= CONVINCING {
            return self.adopt(fix, fix_turn);
        }
        self.doubt = Some(Doubt { pose: fix, count });
        Correction::Doubted
    }

    fn adopt(&mut self, fix: Pose, fix_turn: f32) -> Correction {
        self.bend.restart();
        self.pose = fix;
        self.turn_sigma = fix_turn;
        self.since_fix = Some([0.0; 2]);
        self.doubt = None;
        Correction::Adopted
    }

    fn weigh(&mut self, fix: Pose, fix_turn: f32) {
        let pose = self.pose;
        let (gain, sigma) = fuse(pose.sigma, fix.sigma);
        let (turn_gain, turn_sigma) = fuse(self.turn_sigma, fix_turn);
        let error = wrap(fix.theta - pose.theta);
        self.pose = Pose {
            x: pose.x + gain * (fix.x - pose.x),
            y: pose.y + gain * (fix.y - pose.y),
            theta: wrap(pose.theta + turn_gain * error),
            sigma,
        };
        let variance = self.turn_sigma * self.turn_sigma + fix_turn * fix_turn;
        self.bend.learn(error, variance, turn_gain);
        self.turn_sigma = turn_sigma;
        self.since_fix = Some([0.0; 2]);
        self.doubt = None;
    }

    fn travel(&mut self, forward: f32, turn: f32) {
        let pose = moved(self.pose, forward, turn);
        if !(pose.x.is_finite() && pose.y.is_finite() && pose.theta.is_finite()) {
            return;
        }
        let (way, angle) = (libm::fabsf(forward), libm::fabsf(turn));
        // A heading that is off by more than a radian says nothing of the direction.
        let per_m = SIGMA_PER_M + less(self.turn_sigma, 1.0);
        self.pose = Pose {
            sigma: less(pose.sigma + per_m * way + SIGMA_PER_RAD * angle, SIGMA_MAX),
            ..pose
        };
        let turn_sigma = self.turn_sigma + TURN_SIGMA_PER_M * way + TURN_SIGMA_PER_RAD * angle;
        self.turn_sigma = less(turn_sigma, TURN_SIGMA_MAX);
        if let Some([driven, turned]) = &mut self.since_fix {
            *driven = less(*driven + way, SIGMA_MAX);
            *turned = less(*turned + angle, PI);
        }
        if let Some(doubt) = &mut self.doubt {
            doubt.pose = moved(doubt.pose, forward, turn);
        }
    }
}

/// The less of two numbers: a board has to call a function for `min`, which reckons with what is none.
fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `pose` after an arc of `forward` metres that turns by `turn` radians.
fn moved(pose: Pose, forward: f32, turn: f32) -> Pose {
    let [sin, cos] = sin_cos(pose.theta + turn * 0.5);
    Pose {
        x: pose.x + forward * cos,
        y: pose.y + forward * sin,
        theta: wrap(pose.theta + turn),
        ..pose
    }
}

/// Distance and angle between two poses.
fn offset(a: Pose, b: Pose) -> [f32; 2] {
    let (x, y) = (a.x - b.x, a.y - b.y);
    [
        libm::sqrtf(x * x + y * y),
        libm::fabsf(wrap(a.theta - b.theta)),
    ]
}

/// Whether two estimates of such deviations may be so far apart by chance.
fn is_near(off: f32, one: f32, other: f32) -> bool {
    off <= 0.0 || off * off <= GATE * GATE * (one * one + other * other)
}

/// Weight of a measurement of deviation `measured` against an estimate of deviation `estimated`,
/// and the deviation of the result.
fn fuse(estimated: f32, measured: f32) -> (f32, f32) {
    let (p, r) = (estimated * estimated, measured * measured);
    let gain = p / (p + r);
    let best = estimated.min(measured * BEST_SHARE);
    (gain, libm::sqrtf(gain * r).clamp(best, estimated))
}
