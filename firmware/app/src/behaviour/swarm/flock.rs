//! `flock`: the mean course, its turns and all; separation and cohesion within narrow bounds.
//!
//! Course and rate of turning are agreed upon, as in consensus of second order (Ren and Atkins,
//! "Distributed multi-vehicle coordinated control via local information exchange", Int. J. Robust
//! Nonlinear Control 17, 2007): what was told half a second ago is turned on by the rate that was told with
//! it, so a flock in a turn does not lag behind itself. Keeping together and apart may bend the
//! course by no more than a sixth of a right angle or so, and otherwise changes speed alone.
//!
//! Who sees something that is no neighbour turns to the left, and its neighbours with it; where they turn to
//! the right already, to the right.

use super::{HEADING_GAIN, Scene};
use crate::motion::{Twist, wrap};

/// Nearer than this others are kept off, in millimetres. So a flock has three robots in a cell or so: a
/// message about a cell tells sixteen, and nobody keeps off those that it is not told.
const KEPT_MM: i32 = 1_000;
/// Millimetres of wish for each one by which somebody is nearer than that.
const OFF: i32 = 3;
/// The middle of the neighbours counts for no more than this along each axis, in millimetres.
const MIDDLE_MM: i32 = 500;
/// Tenths of the way to the middle that are wished for.
const TOGETHER: i32 = 8;
/// Slower than this somebody has no course, in millimetres per second.
const SLOW_MM_S: i32 = 50;
/// Bounds of how far the course is bent, in radians.
const BEND: f32 = 0.3;
/// Radians by which it is bent for each metre of wish to the side.
const BEND_PER_M: f32 = 0.5;
/// Share of the speed that is left in any case; the other half depends on who is ahead and behind.
const LEAST: f32 = 0.5;
/// Share of the mean rate of turning that is taken over.
const TURN_SHARE: f32 = 0.9;
/// Turning that is taken over at most, in radians per second.
const MOST_TURN: f32 = 0.5;
/// Turning rate per radian of heading error, per second.
const GAIN: f32 = 0.6 * HEADING_GAIN;
/// Nearer than this what is ahead is turned away from, in millimetres.
const SEEN_MM: i32 = 2_200;
/// Whose course is off by more than this, in radians, takes what is ahead for one of the others.
const STRAY: f32 = 0.7;
/// Rate of turning away from what is at hand, in radians per second, and from what is at [`SEEN_MM`].
const AWAY: [f32; 2] = [1.4, 0.2];

/// Wanted motion.
pub(super) fn flock(scene: &Scene<'_>) -> Twist {
    let theta = if scene.pose.theta.is_finite() {
        scene.pose.theta
    } else {
        0.0
    };
    // Its own course is one of them.
    let mut course = [libm::cosf(theta), libm::sinf(theta)].map(|along| (along * 1_024.0) as i32);
    let mut turn = 0;
    let (mut count, mut moving) = (0, 0);
    let (mut middle, mut apart) = ([0_i32; 2], [0_i32; 2]);
    for other in scene.others() {
        count += 1;
        let [vx, vy] = other.velocity;
        let speed = (vx * vx + vy * vy).isqrt();
        if speed > SLOW_MM_S {
            moving += 1;
            turn += other.turn;
            course[0] += vx * 1_024 / speed;
            course[1] += vy * 1_024 / speed;
        }
        middle[0] += other.at[0];
        middle[1] += other.at[1];
        if other.square < KEPT_MM * KEPT_MM {
            let distance = other.square.isqrt().max(1);
            let push = OFF * (KEPT_MM - distance);
            apart[0] -= push * other.at[0] / distance;
            apart[1] -= push * other.at[1] / distance;
        }
    }
    let angle = if course == [0; 2] {
        theta
    } else {
        libm::atan2f(course[1] as f32, course[0] as f32)
    };
    let error = wrap(angle - theta);
    let turning = if moving > 0 {
        ((turn / moving) as f32 * 0.001).clamp(-MOST_TURN, MOST_TURN)
    } else {
        0.0
    };
    // Along the course and to its left, in 1/1024.
    let [cos, sin] = [libm::cosf(angle), libm::sinf(angle)].map(|along| (along * 1_024.0) as i32);
    let together = |sum: i32| (sum / count.max(1)).clamp(-MIDDLE_MM, MIDDLE_MM) * TOGETHER / 10;
    let wish = [
        apart[0] + together(middle[0]),
        apart[1] + together(middle[1]),
    ];
    let ahead = ((wish[0] * cos + wish[1] * sin) >> 10) as f32 * 0.001;
    let aside = ((wish[1] * cos - wish[0] * sin) >> 10) as f32 * 0.001;
    let bend = (aside * BEND_PER_M).clamp(-BEND, BEND);
    let mut w = TURN_SHARE * turning + GAIN * wrap(error + bend);
    if let Some(distance) = wall(scene, [cos, sin], error) {
        let near = 1.0 - distance as f32 * (1.0 / SEEN_MM as f32);
        let away = AWAY[1] + (AWAY[0] - AWAY[1]) * near;
        w += if turning < -0.05 { -away } else { away };
    }
    let share = (0.5 * (1.0 + LEAST) + 0.5 * (1.0 - LEAST) * ahead.clamp(-1.0, 1.0)).min(1.0);
    Twist {
        v: scene.speed * share,
        w: w.clamp(-scene.max_turn, scene.max_turn),
    }
}

/// Distance of what is ahead and no neighbour, in millimetres.
fn wall(scene: &Scene<'_>, [cos, sin]: [i32; 2], error: f32) -> Option<i32> {
    let distance = i32::from(scene.ahead_mm?);
    if distance >= SEEN_MM || libm::fabsf(error) > STRAY {
        return None;
    }
    let hides = scene.others().any(|other| {
        let [x, y] = other.at;
        let (ahead, aside) = ((x * cos + y * sin) >> 10, (y * cos - x * sin) >> 10);
        ahead > 0 && aside.abs() < 200 + ahead / 3 && ahead < distance + 500
    });
    (!hides).then_some(distance)
}
