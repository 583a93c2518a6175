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

use super::{FULL, HEADING_GAIN, Scene};
use crate::motion::Twist;
use crate::motion::angle::{Angle, length, turned};

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
const SLOW_MM_S: i16 = 50;
/// Milliradians by which the course is bent for each metre of wish to the side, and at most.
const BEND_PER_M: i32 = 500;
const BEND: i32 = 300;
/// Share of the speed where nobody is ahead or behind; a quarter more or less depends on who is.
const MIDDLE: i32 = FULL * 3 / 4;
/// Tenths of the mean rate of turning that are taken over.
const TURN_SHARE: i32 = 9;
/// Turning that is taken over at most, in 1/1024 rad/s like all rates here.
const MOST_TURN: i32 = 512;
/// Turning rate per radian of heading error, per second, in 1/10.
const GAIN: i32 = (6.0 * HEADING_GAIN) as i32;
/// Nearer than this what is ahead is turned away from, in millimetres.
const SEEN_MM: i32 = 2_200;
/// Whose course is off by more than this, in milliradians, takes what is ahead for one of the others.
const STRAY: i32 = 700;
/// Rate of turning away from what is at hand, and from what is at [`SEEN_MM`].
const AWAY: [i32; 2] = [1_434, 205];
/// Neighbours that turn to the right by more than this are turned with.
const RIGHT: i32 = -51;

/// Wanted motion.
pub(super) fn flock(scene: &Scene<'_>) -> Twist {
    let here = &scene.here;
    // Its own course is one of them.
    let mut course = here.ahead;
    let mut turn = 0;
    let (mut count, mut moving) = (0, 0);
    let (mut middle, mut apart) = ([0_i32; 2], [0_i32; 2]);
    for other in scene.near {
        let Some(other) = scene.other(other) else {
            continue;
        };
        count += 1;
        let [x, y] = other.is.ahead.map(i32::from);
        if other.is.speed > SLOW_MM_S {
            moving += 1;
            turn += i32::from(other.is.turn);
            course = [course[0] + x, course[1] + y];
        } else if other.is.speed < -SLOW_MM_S {
            moving += 1;
            turn += i32::from(other.is.turn);
            course = [course[0] - x, course[1] - y];
        }
        middle[0] += other.at[0];
        middle[1] += other.at[1];
        if other.square < KEPT_MM * KEPT_MM {
            let distance = length(other.at).max(1);
            let push = OFF * (KEPT_MM - distance);
            apart[0] -= push * other.at[0] / distance;
            apart[1] -= push * other.at[1] / distance;
        }
    }
    let angle = if course == [0; 2] {
        here.heading
    } else {
        Angle::of(course)
    };
    let error = angle.minus(here.heading).milliradians();
    let turning = if moving > 0 {
        (turn / moving).clamp(-MOST_TURN, MOST_TURN)
    } else {
        0
    };
    let direction = angle.direction();
    let together = |sum: i32| (sum / count.max(1)).clamp(-MIDDLE_MM, MIDDLE_MM) * TOGETHER / 10;
    let wish = [
        apart[0] + together(middle[0]),
        apart[1] + together(middle[1]),
    ];
    let [ahead, aside] = turned(wish.map(|along| along.clamp(-40_000, 40_000)), direction);
    let bend = (aside * BEND_PER_M / 1_000).clamp(-BEND, BEND);
    let bent = Angle::from_milliradians(error + bend).milliradians();
    let mut w = TURN_SHARE * turning / 10 + GAIN * bent * 1_024 / 10_000;
    if let Some(distance) = wall(scene, direction, error) {
        let away = AWAY[1] + (AWAY[0] - AWAY[1]) * (SEEN_MM - distance) / SEEN_MM;
        w += if turning < RIGHT { -away } else { away };
    }
    let share = MIDDLE + (FULL - MIDDLE) * ahead.clamp(-1_000, 1_000) / 1_000;
    Twist {
        v: scene.speed * (share as f32 * (1.0 / FULL as f32)),
        w: (w as f32 * (1.0 / 1_024.0)).clamp(-scene.max_turn, scene.max_turn),
    }
}

/// Distance of what is ahead and no neighbour, in millimetres.
fn wall(scene: &Scene<'_>, direction: [i32; 2], error: i32) -> Option<i32> {
    let distance = i32::from(scene.ahead_mm?);
    if distance >= SEEN_MM || error.abs() > STRAY {
        return None;
    }
    for other in scene.near {
        let Some(other) = scene.other(other) else {
            continue;
        };
        let [ahead, aside] = turned(other.at, direction);
        if ahead > 0 && aside.abs() < 200 + ahead / 3 && ahead < distance + 500 {
            return None;
        }
    }
    Some(distance)
}
