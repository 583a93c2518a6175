//! Going to a place by odometry.

use crawler_protocol::Pose;

use crate::motion::{Twist, wrap};

/// Turning rate per radian of heading error, per second. The wheels follow with a lag of about
/// 0.1 s, so that 2.5/s comes in without overshoot.
const HEADING_GAIN: f32 = 2.5;
/// Beyond this heading error the robot turns in place: an arc would lead it away first.
const TURN_IN_PLACE: f32 = 1.0;
/// Within this distance the robot slows down, in metres.
const SLOW_WITHIN: f32 = 0.4;
/// Share of the speed it keeps at the end.
const SLOWEST: f32 = 0.3;

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
        speed * (distance / SLOW_WITHIN).clamp(SLOWEST, 1.0) * libm::cosf(error)
    };
    Some(Twist { v, w })
}
