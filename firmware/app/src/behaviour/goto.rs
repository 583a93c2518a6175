//! Going to a place by odometry.

use crawler_protocol::Pose;

use crate::motion::angle::{Angle, ONE, PoseMm, length, turned, unit};
use crate::motion::{Twist, sin_cos, wrap};

/// Turning rate per radian of heading error, per second. The wheels follow with a lag of about
/// 0.1 s, so that 2.5/s comes in without overshoot.
pub(crate) const HEADING_GAIN: f32 = 2.5;
/// Beyond this heading error the robot turns in place: an arc would lead it away first.
const TURN_IN_PLACE: f32 = 1.0;
/// Within this distance the robot slows down, in metres.
pub(crate) const SLOW_WITHIN: f32 = 0.4;
/// Share of the speed it keeps at the end.
pub(crate) const SLOWEST: f32 = 0.3;

/// As [`goto_twist`], in whole millimetres: for a robot that reckons with neighbours in the same step.
pub fn place_twist(
    here: &PoseMm,
    target: [i32; 2],
    tolerance: i32,
    speed: f32,
    max_turn: f32,
) -> Option<Twist> {
    const SLOW_WITHIN_MM: i32 = (SLOW_WITHIN * 1_000.0) as i32;
    /// What stands for the whole speed.
    const FULL: i32 = 1_024;
    const SLOWEST_PART: i32 = (SLOWEST * FULL as f32) as i32;
    let to = [0, 1].map(|axis: usize| target[axis].saturating_sub(here.at[axis]));
    let distance = length(to);
    if distance <= tolerance {
        return None;
    }
    let way = unit(to);
    let [cos, sin] = turned(way, here.ahead);
    let error = Angle::of([cos, sin]).radians();
    let w = (HEADING_GAIN * error).clamp(-max_turn, max_turn);
    let v = if libm::fabsf(error) > TURN_IN_PLACE {
        0.0
    } else {
        let part = (distance.min(SLOW_WITHIN_MM) * FULL / SLOW_WITHIN_MM).max(SLOWEST_PART);
        speed * ((part * cos.min(ONE)) as f32 * (1.0 / (FULL * ONE) as f32))
    };
    Some(Twist { v, w })
}

/// Wanted motion towards `target`; `None` within `tolerance` metres of it.
pub fn goto_twist(
    pose: &Pose,
    target: [f32; 2],
    tolerance: f32,
    speed: f32,
    max_turn: f32,
) -> Option<Twist> {
    let [dx, dy] = [target[0] - pose.x, target[1] - pose.y];
    let distance = libm::hypotf(dx, dy);
    if distance <= tolerance {
        return None;
    }
    let error = wrap(libm::atan2f(dy, dx) - pose.theta);
    let w = (HEADING_GAIN * error).clamp(-max_turn, max_turn);
    let v = if libm::fabsf(error) > TURN_IN_PLACE {
        0.0
    } else {
        speed * (distance / SLOW_WITHIN).clamp(SLOWEST, 1.0) * sin_cos(error)[1]
    };
    Some(Twist { v, w })
}
