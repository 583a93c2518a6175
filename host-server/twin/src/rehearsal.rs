//! Where a drive may lead: rehearsed by bodies as different as robots can be.
//!
//! What a robot makes of its orders nobody knows before it is calibrated. So the drive is rehearsed by many bodies,
//! with words that come late and fixes that are off, and what all of them swept is what it may take: for each
//! direction how far from where it began. A robot is not proved to stay within; whoever drives it watches it as well.

use crate::body::{Parameters, Pose, STEP_S, Wheels, wrap};
use crate::course::{Course, Limits, Random};
use crate::drive::RAMP_PER_S;

/// Directions in which it is looked how far a drive may lead.
pub const DIRECTIONS: usize = 24;
/// Bodies that rehearse.
pub const BODIES: usize = 400;
/// Steps between two looks.
const LOOKED: u64 = 5;
/// A wheel stands so long before it turns the other way, seconds.
const DEAD_TIME_S: f64 = 0.04;

/// What a drive may take of the floor, seen from where it begins.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// How far the middle of the robot gets in each direction, metres; the first is ahead, the others follow
    /// anticlockwise.
    pub reach: [f64; DIRECTIONS],
    /// How long the drive takes, seconds.
    pub seconds: f64,
}

fn direction(k: usize) -> [f64; 2] {
    let angle = std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
    let (sin, cos) = angle.sin_cos();
    [cos, sin]
}

impl Sweep {
    /// Of a drive within `limits`, of a robot whose place is known to `sigma_m` and whose heading to `sigma_rad`.
    #[must_use]
    pub fn of(limits: Limits, (sigma_m, sigma_rad): (f64, f64)) -> Self {
        let mut reach = [0.0_f64; DIRECTIONS];
        for body in 0..BODIES as u64 {
            let mut random = Random::new(body);
            let start = Pose {
                x: sigma_m * random.normal(),
                y: sigma_m * random.normal(),
                theta: sigma_rad * random.normal(),
            };
            rehearse(limits, start, &mut random, |pose| {
                for (k, reach) in reach.iter_mut().enumerate() {
                    let [x, y] = direction(k);
                    *reach = reach.max(pose.x * x + pose.y * y);
                }
            });
        }
        Self {
            reach,
            seconds: Course::new(limits, 0).seconds(),
        }
    }

    /// The corners of what it takes of the floor when it begins at `start`, with so many metres more on each side.
    #[must_use]
    pub fn corners(&self, start: Pose, more_m: f64) -> Vec<[f64; 2]> {
        let half = std::f64::consts::PI / DIRECTIONS as f64;
        (0..DIRECTIONS)
            .map(|k| {
                // Where the bounds of this direction and of the next one meet.
                let (one, two) = (self.reach[k], self.reach[(k + 1) % DIRECTIONS]);
                let angle = std::f64::consts::TAU * k as f64 / DIRECTIONS as f64;
                let along = one + more_m;
                let turn = 2.0 * half;
                let across = (two + more_m - along * turn.cos()) / turn.sin();
                let (sin, cos) = angle.sin_cos();
                let there = start.then(Pose {
                    x: along * cos - across * sin,
                    y: along * sin + across * cos,
                    theta: 0.0,
                });
                [there.x, there.y]
            })
            .collect()
    }

    /// Whether a place is within, by `more_m` at least beyond what was swept.
    #[must_use]
    pub fn holds(&self, start: Pose, at: [f64; 2], more_m: f64) -> bool {
        let there = start.sees(Pose {
            x: at[0],
            y: at[1],
            theta: 0.0,
        });
        self.reach.iter().enumerate().all(|(k, reach)| {
            let [x, y] = direction(k);
            there.x * x + there.y * y <= reach + more_m
        })
    }

    /// Length and width, metres.
    #[must_use]
    pub fn size(&self) -> [f64; 2] {
        let side = |k: usize| self.reach[k] + self.reach[k + DIRECTIONS / 2];
        [side(0), side(DIRECTIONS / 4)]
    }
}

/// A body, and how it is told what to do.
struct Robot {
    body: Parameters,
    open_v: f64,
    /// Speed for each volt, friction and track as its own program believes them.
    believed: (f64, f64, f64),
    /// Until an order is obeyed, seconds.
    late_s: f64,
    /// How much the heading wanders, radians for the root of a metre.
    wander: f64,
}

impl Robot {
    /// As different as robots can be: the simulator's wildest ranges and some more, and programs that believe in the
    /// bodies of the data sheets there are.
    fn draw(random: &mut Random) -> Self {
        let r = random;
        let nominal = Parameters::NOMINAL;
        let mut each = |value: f64, common: f64, own: f64| {
            let both = value * r.about(common);
            [both * r.about(own), both * r.about(own)]
        };
        let speed_per_volt = each(nominal.speed_per_volt[0], 0.18, 0.06);
        let friction_v = each(nominal.friction_v[0], 0.35, 0.12);
        let body = Parameters {
            speed_per_volt,
            friction_v,
            backward: r.about(0.04),
            lag_straight_s: nominal.lag_straight_s * r.about(0.4),
            lag_turn_s: nominal.lag_turn_s * r.about(0.4),
            coast: nominal.coast * r.about(0.5),
            track_m: nominal.track_m * r.about(0.06),
            internal_ohm: nominal.internal_ohm * r.about(0.5),
            ..nominal
        };
        let other = r.share();
        let between = |one: f64, two: f64| one + (two - one) * other;
        Self {
            body,
            open_v: 7.4 + r.within(0.9),
            believed: (
                between(0.128, 0.113),
                between(0.7, 0.72),
                between(0.14, 0.15),
            ),
            late_s: 0.02 + 0.2 * r.share(),
            wander: 0.05 * r.share(),
        }
    }

    /// Duties that its program gives for an order.
    fn duties(&self, v: f64, w: f64, most_v: f64) -> [f64; 2] {
        let (per_volt, friction, track) = self.believed;
        let (left, right) = (v - 0.5 * w * track, v + 0.5 * w * track);
        let scale = (most_v / left.abs().max(right.abs()).max(1e-9)).min(1.0);
        let full = self.open_v - self.body.bridge_drop_v;
        [left, right].map(|speed| {
            let speed = speed * scale;
            if speed.abs() < 1e-3 {
                return 0.0;
            }
            ((friction + speed.abs() / per_volt) / full).min(1.0) * speed.signum()
        })
    }
}

/// Lets a body drive, and shows where it gets.
fn rehearse(limits: Limits, start: Pose, random: &mut Random, mut shown: impl FnMut(Pose)) {
    let robot = Robot::draw(random);
    let mut course = Course::new(limits, (random.share() * 1e9) as u64);
    let (mut wheels, mut pose) = (Wheels::default(), start);
    let (mut duty, mut stood_s) = ([0.0_f64; 2], [1.0_f64; 2]);
    let mut before = [0.0_f64; 2];
    // What was decided, and what is obeyed by now.
    let (mut wanted, mut obeyed) = ([0.0; 2], [0.0; 2]);
    let (mut at_s, mut until_s, mut told_s) = (0.0, 0.0, f64::INFINITY);
    let mut steps = 0_u64;
    let (mut seen, mut seen_s) = (start, 0.0);
    loop {
        if at_s >= until_s {
            // What is known of where it is, is old and off.
            let fix = Pose {
                x: seen.x + 0.015 * random.normal(),
                y: seen.y + 0.015 * random.normal(),
                theta: seen.theta + 0.03 * random.normal(),
            };
            let Some((_, leg)) = course.next(fix, at_s - seen_s) else {
                return;
            };
            until_s += leg.seconds + 0.1 * random.share();
            wanted = robot.duties(leg.v, leg.w, limits.v);
            told_s = at_s + robot.late_s + 0.1 * random.share();
        }
        if at_s >= told_s {
            (obeyed, told_s) = (wanted, f64::INFINITY);
        }
        for k in 0..2 {
            let reverses = duty[k] * obeyed[k] < 0.0
                || (duty[k] == 0.0 && before[k] * obeyed[k] < 0.0 && stood_s[k] < DEAD_TIME_S);
            let goal = if reverses { 0.0 } else { obeyed[k] };
            let most = RAMP_PER_S * STEP_S;
            let next = duty[k] + (goal - duty[k]).clamp(-most, most);
            if next == 0.0 && duty[k] != 0.0 {
                (before[k], stood_s[k]) = (duty[k], 0.0);
            }
            stood_s[k] += STEP_S;
            duty[k] = next;
        }
        let last = wheels;
        wheels.step(&robot.body, duty, robot.open_v);
        let motion = wheels.motion(last, robot.body.track_m);
        pose = pose.then(motion);
        pose.theta = wrap(pose.theta + robot.wander * motion.x.abs().sqrt() * random.within(1.7));
        if steps.is_multiple_of(LOOKED) {
            shown(pose);
        }
        if steps.is_multiple_of(20) {
            (seen, seen_s) = (pose, at_s);
        }
        steps += 1;
        at_s += STEP_S;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const USUAL: Limits = Limits { v: 0.5, w: 3.0 };

    #[test]
    fn a_drive_takes_little_floor_and_time() {
        let sweep = Sweep::of(USUAL, (0.01, 0.03));
        let [length, width] = sweep.size();
        assert!(sweep.seconds <= 85.0, "{}", sweep.seconds);
        assert!(length <= 1.6 && width <= 1.6, "{length} × {width}");
    }

    #[test]
    fn corners_hold_all_that_was_swept() {
        let sweep = Sweep::of(USUAL, (0.0, 0.0));
        let start = Pose {
            x: 3.0,
            y: -2.0,
            theta: 2.1,
        };
        for (k, reach) in sweep.reach.iter().enumerate() {
            let [x, y] = direction(k);
            let there = start.then(Pose {
                x: x * reach,
                y: y * reach,
                theta: 0.0,
            });
            // In one direction as far as that; in the others less may do.
            assert!(!sweep.holds(start, [there.x * 1.5 - 1.5, there.y * 1.5 + 1.0], 0.0));
        }
        for corner in sweep.corners(start, 0.0) {
            assert!(sweep.holds(start, corner, 1e-9), "{corner:?}");
            assert!(!sweep.holds(start, corner, -1e-3), "{corner:?}");
        }
        assert!(sweep.holds(start, [3.0, -2.0], 0.0));
    }
}
