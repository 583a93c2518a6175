//! The body that a twin believes in: two geared motors on one pack, and wheels that roll.
//!
//! A rim settles at `speed_per_volt` · (duty · motor volts − `friction_v`). On the way there both
//! rims lag as the mass straight ahead and the inertia of a turn have it; a wheel without duty is
//! slowed by its grease alone, and a standing one starts at `breakaway` times its friction. Wheels
//! that slide, and walls, are outside of what a twin knows: there its evidence is not used.

use serde::{Deserialize, Serialize};

/// Time of one step, seconds.
pub const STEP_S: f64 = 0.01;

/// Slower than this an undriven wheel stands, metres per second.
const STANDSTILL: f64 = 1e-4;

/// A place and a heading: metres and radians, anticlockwise.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Pose {
    /// Metres along the x axis.
    pub x: f64,
    /// Metres along the y axis.
    pub y: f64,
    /// Heading, not wrapped.
    pub theta: f64,
}

impl Pose {
    /// Where somebody is who is at `motion` as seen from here.
    #[must_use]
    pub fn then(self, motion: Self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        Self {
            x: self.x + cos * motion.x - sin * motion.y,
            y: self.y + sin * motion.x + cos * motion.y,
            theta: self.theta + motion.theta,
        }
    }

    /// Where `other` is as seen from here.
    #[must_use]
    pub fn sees(self, other: Self) -> Self {
        let (sin, cos) = self.theta.sin_cos();
        let (dx, dy) = (other.x - self.x, other.y - self.y);
        Self {
            x: cos * dx + sin * dy,
            y: cos * dy - sin * dx,
            theta: other.theta - self.theta,
        }
    }

    /// Distance between two places.
    #[must_use]
    pub fn distance(self, other: Self) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }

    /// Between two poses, `share` of the way.
    pub(crate) fn between(self, other: Self, share: f64) -> Self {
        Self {
            x: self.x + (other.x - self.x) * share,
            y: self.y + (other.y - self.y) * share,
            theta: self.theta + (other.theta - self.theta) * share,
        }
    }
}

/// An angle within half a turn of zero.
#[must_use]
pub fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle - (angle / turn).round() * turn
}

/// What a twin believes of a body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parameters {
    /// Rim speed of the left and the right wheel for each volt at the motor beyond friction, metres
    /// per second.
    pub speed_per_volt: [f64; 2],
    /// Volts that dry friction costs each motor while it turns.
    pub friction_v: [f64; 2],
    /// What both motors make of their voltage backward, as a share of what they make of it forward.
    pub backward: f64,
    /// Friction of a standing wheel, as a multiple of that of a turning one.
    pub breakaway: f64,
    /// Time constant of the speed straight ahead, seconds.
    pub lag_straight_s: f64,
    /// Time constant of the turning speed, seconds.
    pub lag_turn_s: f64,
    /// Share of the damping that is left without duty.
    pub coast: f64,
    /// Distance between the wheels, as it acts, metres.
    pub track_m: f64,
    /// What is added to a stamp of the robot to have the tracker's time at which it was so, seconds.
    pub latency_s: f64,
    /// Of the pack, ohms.
    pub internal_ohm: f64,
    /// Of a motor with the slope of its bridge, ohms.
    pub winding_ohm: f64,
    /// Volts that the bridge keeps.
    pub bridge_drop_v: f64,
    /// What everything but the motors draws, amperes.
    pub quiescent_a: f64,
}

impl Parameters {
    /// The chassis of the data sheets; the same as that of the simulator, which a test compares.
    pub const NOMINAL: Self = Self {
        speed_per_volt: [0.128; 2],
        friction_v: [0.7; 2],
        backward: 1.0,
        breakaway: 0.9 / 0.7,
        // Half the robot and a rotor, 0.415 kg, over 3.9 N/A / (6.6 Ω · 0.128 m/s/V).
        lag_straight_s: 0.0899,
        lag_turn_s: 0.0899,
        coast: 0.18,
        track_m: 0.14,
        latency_s: 0.0,
        internal_ohm: 0.18,
        winding_ohm: 6.6,
        bridge_drop_v: 1.4,
        quiescent_a: 0.15,
    };

    /// Speed at which each rim settles at `duty` when the pack delivers `volts`, metres per second.
    #[must_use]
    pub fn settled(&self, duty: f64, volts: f64) -> [f64; 2] {
        let motor = duty.abs() * (volts - self.bridge_drop_v).max(0.0);
        let motor = if duty < 0.0 {
            motor * self.backward
        } else {
            motor
        };
        let size = |k: usize| (motor - self.friction_v[k]).max(0.0) * self.speed_per_volt[k];
        [size(0) * duty.signum(), size(1) * duty.signum()]
    }

    /// Whether all numbers are such as a body can have.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let within = |value: f64, low: f64, high: f64| (low..=high).contains(&value);
        (0..2).all(|k| {
            within(self.speed_per_volt[k], 0.01, 0.5) && within(self.friction_v[k], 0.0, 4.0)
        }) && within(self.backward, 0.5, 2.0)
            && within(self.breakaway, 1.0, 10.0)
            && within(self.lag_straight_s, 0.001, 2.0)
            && within(self.lag_turn_s, 0.001, 2.0)
            && within(self.coast, 0.0, 1.0)
            && within(self.track_m, 0.02, 0.5)
            && within(self.latency_s, -1.0, 1.0)
            && within(self.internal_ohm, 0.0, 3.0)
            && within(self.winding_ohm, 0.5, 200.0)
            && within(self.bridge_drop_v, 0.0, 5.0)
            && within(self.quiescent_a, 0.0, 5.0)
    }
}

/// Speeds of both rims.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wheels {
    /// Left and right, metres per second.
    pub rims: [f64; 2],
}

impl Wheels {
    /// Lets [`STEP_S`] pass at `duty` (−1 to 1) on a pack of `open_v` without load. Returns the
    /// current that the pack gave, amperes.
    pub fn step(&mut self, parameters: &Parameters, duty: [f64; 2], open_v: f64) -> f64 {
        let p = parameters;
        let (motor_v, current) = self.supply(p, duty, open_v);
        let own = (p.lag_straight_s + p.lag_turn_s) * 0.5;
        let other = (p.lag_straight_s - p.lag_turn_s) * 0.5;
        // Half of the damping after the step is exact to second order; a wheel that comes to rest
        // within one has more.
        let implicit = (1.0 - own / STEP_S).max(0.5);
        let rims = self.rims;
        let (mut weight, mut asked) = ([0.0; 2], [0.0; 2]);
        let (mut locked, mut holds) = ([false; 2], [false; 2]);
        for k in 0..2 {
            let damping = if duty[k] == 0.0 { p.coast } else { 1.0 };
            let gain = if duty[k] < 0.0 { p.backward } else { 1.0 };
            let push = duty[k] * motor_v * gain * p.speed_per_volt[k];
            let running = p.friction_v[k] * p.speed_per_volt[k];
            holds[k] = push.abs() <= running * p.breakaway;
            let direction = if rims[k] == 0.0 {
                locked[k] = holds[k];
                push
            } else {
                rims[k]
            };
            weight[k] = own + implicit * damping * STEP_S;
            asked[k] = STEP_S * (push - damping * rims[k] - running.copysign(direction));
        }
        let mut change = match locked {
            [true, true] => return current,
            [true, false] => [0.0, asked[1] / weight[1]],
            [false, true] => [asked[0] / weight[0], 0.0],
            [false, false] => {
                let scale = 1.0 / (weight[0] * weight[1] - other * other);
                [
                    (asked[0] * weight[1] - asked[1] * other) * scale,
                    (asked[1] * weight[0] - asked[0] * other) * scale,
                ]
            }
        };
        // Friction stops a wheel, it does not turn it round.
        for k in 0..2 {
            let next = rims[k] + change[k];
            let stops = rims[k] * next < 0.0 || (next.abs() < STANDSTILL && holds[k]);
            if stops && !locked[k] {
                change[k] = -rims[k];
                locked[k] = true;
                let left = 1 - k;
                if !locked[left] {
                    change[left] = (asked[left] - other * change[k]) / weight[left];
                }
            }
        }
        self.rims = [rims[0] + change[0], rims[1] + change[1]];
        current
    }

    /// Volts at full duty behind the bridge, and the current of the pack: the sag and the current that
    /// causes it are solved together.
    fn supply(&self, p: &Parameters, duty: [f64; 2], open_v: f64) -> (f64, f64) {
        let idle = open_v - p.internal_ohm * p.quiescent_a;
        let (mut per_volt, mut less) = (0.0, 0.0);
        for (k, duty) in duty.iter().enumerate() {
            let size = duty.abs();
            let strength = size * size / p.winding_ohm;
            let back_v = (1.0 - p.coast) / p.speed_per_volt[k];
            let back = duty * back_v * self.rims[k] / p.winding_ohm + strength * p.bridge_drop_v;
            if strength * idle > back {
                per_volt += strength;
                less += back;
            }
        }
        let volts = (idle + p.internal_ohm * less) / (1.0 + p.internal_ohm * per_volt);
        let motors = (per_volt * volts - less).max(0.0);
        let volts = idle - p.internal_ohm * motors;
        ((volts - p.bridge_drop_v).max(0.0), p.quiescent_a + motors)
    }

    /// Where a step at the mean of the speeds `before` and now leads, as seen from where it begins.
    #[must_use]
    pub fn motion(&self, before: Self, track_m: f64) -> Pose {
        let left = (before.rims[0] + self.rims[0]) * 0.5 * STEP_S;
        let right = (before.rims[1] + self.rims[1]) * 0.5 * STEP_S;
        arc(left, right, track_m)
    }
}

/// Where wheels that roll so far lead, along the middle heading.
pub(crate) fn arc(left: f64, right: f64, track_m: f64) -> Pose {
    let (way, turn) = ((left + right) * 0.5, (right - left) / track_m);
    // The heading turns by little in a step: a short series is as good.
    let half = turn * 0.5;
    let (sin, cos) = (half - half * half * half / 6.0, 1.0 - half * half * 0.5);
    Pose {
        x: way * cos,
        y: way * sin,
        theta: turn,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_settles_where_it_says_and_rolls_out() {
        let p = Parameters::NOMINAL;
        let mut wheels = Wheels::default();
        for _ in 0..200 {
            wheels.step(&p, [0.6, 0.6], 7.8);
        }
        let sagged = 7.8 - p.internal_ohm * wheels.step(&p, [0.6, 0.6], 7.8);
        let settled = p.settled(0.6, sagged);
        assert!(
            (wheels.rims[0] - settled[0]).abs() < 1e-3,
            "{wheels:?} {settled:?}"
        );
        for _ in 0..100 {
            wheels.step(&p, [0.0, 0.0], 7.8);
        }
        assert_eq!(wheels.rims, [0.0; 2], "friction brings it to rest");
        // Less than friction does not move it.
        for _ in 0..100 {
            wheels.step(&p, [0.1, -0.1], 7.8);
        }
        assert_eq!(wheels.rims, [0.0; 2]);
    }

    #[test]
    fn poses_compose_and_come_apart_again() {
        let a = Pose {
            x: 1.0,
            y: -2.0,
            theta: 2.5,
        };
        let b = Pose {
            x: 0.3,
            y: 0.1,
            theta: -0.7,
        };
        let back = a.sees(a.then(b));
        assert!((back.x - b.x).abs() + (back.y - b.y).abs() + (back.theta - b.theta).abs() < 1e-12);
        assert!((wrap(7.0) - (7.0 - std::f64::consts::TAU)).abs() < 1e-12);
    }
}
