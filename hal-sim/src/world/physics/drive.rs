//! Motors, wheels and what the floor takes of their force.
//!
//! All speeds of a wheel are at its rim, all forces at its contact with the floor. A robot has
//! four speeds: that of the body ahead (`longitudinal`), to the side (`lateral`), by its turn at a wheel
//! (`yaw` = spin · track / 2), and the two rims. While a wheel rolls its rim and the floor under
//! it are equally fast; else it slides, and friction is at its limit.

use super::super::bodies::{Bridge, Build, Drive};
use super::super::geometry::Vec2;
use super::super::parameters::Parameters;

/// Acceleration of free fall, metres per second squared.
const GRAVITY: f32 = 9.81;

/// Sweeps of the solver for sliding wheels and walls.
const SWEEPS: u8 = 12;

/// Change of speed within a sweep that is not worth another one, metres per second.
const SETTLED: f32 = 2e-6;

/// A rim this close to the speed of the floor rolls, metres per second.
const ROLLING: f32 = 1e-4;

/// Slower than this an undriven wheel stands, metres per second.
const STANDSTILL: f32 = 1e-4;

/// What of the drive train is the same for all robots and steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Train {
    dt: f32,
    /// Newtons at the rim for each volt at the motor.
    per_volt: f32,
    /// Volts that a turning motor gives back, for each metre per second of the rim.
    pub(super) back_v: f32,
    /// One over the winding's resistance.
    pub(super) per_ohm: f32,
    bridge_drop_v: f32,
    /// Newtons for each metre per second, by back voltage and by grease.
    electric: f32,
    viscous: f32,
    /// Newtons of dry friction, turning and standing.
    running: f32,
    breakaway: f32,
    rotor_kg: f32,
    /// Newton seconds that the floor takes up in a step under one wheel, for each kilogram of the
    /// robot.
    grip: f32,
    /// Where in the step the damping acts: half of it before and half after is exact to second
    /// order; more after when the step is longer than a wheel needs to come to rest.
    implicit: f32,
}

impl Train {
    pub(crate) fn new(parameters: &Parameters, dt: f32) -> Self {
        let chassis = &parameters.chassis;
        let per_volt = chassis.force_per_amp / chassis.winding_ohm;
        let damping = chassis.damping();
        Self {
            dt,
            per_volt,
            back_v: (1.0 - chassis.drag_share) / chassis.speed_per_volt,
            per_ohm: 1.0 / chassis.winding_ohm,
            bridge_drop_v: chassis.bridge_drop_v,
            electric: damping * (1.0 - chassis.drag_share),
            viscous: damping * chassis.drag_share,
            running: chassis.running_v * per_volt,
            breakaway: chassis.breakaway_v * per_volt,
            rotor_kg: chassis.rotor_kg,
            grip: chassis.grip * chassis.wheel_load * 0.5 * GRAVITY * dt,
            implicit: (1.0 - chassis.rotor_kg / (damping * dt)).max(0.5),
        }
    }

    /// Volts at the motor for each unit of duty.
    pub(super) fn motor_v(&self, supply_v: f32) -> f32 {
        (supply_v - self.bridge_drop_v).max(0.0)
    }

    /// What the bridge makes of a motor.
    pub(super) fn motor(&self, bridge: Bridge, gain: f32, friction: f32, motor_v: f32) -> Motor {
        let duty = f32::from(bridge.duty) * (1.0 / 255.0);
        let (sign, damping) = match bridge.drive() {
            _ if bridge.duty == 0 => (0.0, self.viscous),
            Drive::Forward => (1.0, self.viscous + self.electric),
            Drive::Backward => (-1.0, self.viscous + self.electric),
            Drive::Brake => (0.0, self.viscous + self.electric * duty),
        };
        Motor {
            push: sign * duty * motor_v * gain * self.per_volt,
            damping,
            running: self.running * friction,
            breakaway: self.breakaway * friction,
        }
    }
}

/// A motor in one step: its force on the rim is `push` − `damping` · speed, less dry friction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motor {
    push: f32,
    damping: f32,
    running: f32,
    breakaway: f32,
}

impl Motor {
    /// Whether a standing wheel stays where it is.
    pub(super) fn holds(&self) -> bool {
        self.push.abs() <= self.breakaway
    }

    fn friction(&self, rim: f32) -> f32 {
        if rim == 0.0 {
            self.breakaway
        } else {
            self.running
        }
    }
}

/// Speeds of a robot, metres per second; see the [module](self).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Speeds {
    pub(super) longitudinal: f32,
    pub(super) lateral: f32,
    pub(super) yaw: f32,
    pub(super) rims: [f32; 2],
}

impl Speeds {
    /// Speed of the floor under the wheels.
    fn ground(&self) -> [f32; 2] {
        [self.longitudinal - self.yaw, self.longitudinal + self.yaw]
    }
}

/// A surface that does not give way: the body's speed along `normal` must be at least `least`.
/// `normal` is in the frame of the robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stop {
    pub(crate) normal: Vec2,
    pub(crate) least: f32,
    /// Speed along the normal that was taken up so far.
    pub(crate) taken: f32,
}

/// Lets rolling wheels roll on for a step in which the robot turns by about `angle`. `None` when
/// the floor does not take up the force: then they slide.
pub(super) fn roll(
    train: &Train,
    build: &Build,
    motors: &[Motor; 2],
    grip: [f32; 2],
    rims: [f32; 2],
) -> Option<[f32; 2]> {
    let dt = train.dt;
    let own = train.rotor_kg + (build.mass_kg + build.turn_kg) * 0.25;
    let other = (build.mass_kg - build.turn_kg) * 0.25;
    let weigh = |k: usize| own + train.implicit * motors[k].damping * dt;
    let (a, b) = (weigh(0), weigh(1));
    let mut locked = [false; 2];
    let mut asked = [0.0_f32; 2];
    for k in 0..2 {
        let (motor, rim) = (&motors[k], rims[k]);
        let direction = if rim == 0.0 {
            locked[k] = motor.holds();
            motor.push
        } else {
            rim
        };
        asked[k] = dt * (motor.push - motor.damping * rim - motor.running.copysign(direction));
    }
    let mut change = match locked {
        [true, true] => return Some([0.0; 2]),
        [true, false] => [0.0, asked[1] / b],
        [false, true] => [asked[0] / a, 0.0],
        [false, false] => {
            let scale = 1.0 / (a * b - other * other);
            [
                (asked[0] * b - asked[1] * other) * scale,
                (asked[1] * a - asked[0] * other) * scale,
            ]
        }
    };
    // Friction stops a wheel, it does not turn it round.
    for k in 0..2 {
        let next = rims[k] + change[k];
        let stops = rims[k] * next < 0.0 || (next.abs() < STANDSTILL && motors[k].holds());
        if stops && !locked[k] {
            change[k] = -rims[k];
            locked[k] = true;
            if !locked[1 - k] {
                let weight = if k == 0 { b } else { a };
                change[1 - k] = (asked[1 - k] - other * change[k]) / weight;
            }
        }
    }
    let own = own - train.rotor_kg;
    let force = [
        own * change[0] + other * change[1],
        own * change[1] + other * change[0],
    ];
    // What keeps the robot on its arc.
    let speed = (rims[0] + rims[1] + (change[0] + change[1]) * 0.5) * 0.5;
    let yaw = (rims[1] - rims[0] + (change[1] - change[0]) * 0.5) * 0.5;
    let across = build.mass_kg * speed * yaw * build.per_half_track * dt * 0.5;
    for k in 0..2 {
        let limit = train.grip * build.mass_kg * grip[k];
        // Not-a-number does not roll either.
        let holds = force[k] * force[k] + across * across <= limit * limit;
        if !holds {
            return None;
        }
    }
    Some([rims[0] + change[0], rims[1] + change[1]])
}

/// Moves wheels on that slide, or a body that something holds back. Returns the new speeds, and
/// whether both wheels roll.
///
/// Friction of both wheels, stiction of both motors and all stops are solved together by
/// Gauss–Seidel sweeps over the impulses, each kept within its limit. `bend` is the sideways part
/// of the speed that a rolling body needs in the frame of the middle of the step.
pub(super) fn slide(
    train: &Train,
    build: &Build,
    motors: &[Motor; 2],
    grip: [f32; 2],
    from: Speeds,
    bend: f32,
    stops: &mut [Stop],
) -> (Speeds, bool) {
    let dt = train.dt;
    let (per_mass, per_turn) = (1.0 / build.mass_kg, 1.0 / build.turn_kg);
    let weigh = |k: usize| train.rotor_kg + train.implicit * motors[k].damping * dt;
    let weight = [weigh(0), weigh(1)];
    let per_weight = weight.map(|weight| 1.0 / weight);
    let scale = per_weight.map(|own| 1.0 / (per_mass + per_turn + own));
    // A sweep that changes less ends it, newton seconds.
    let settled = build.mass_kg * SETTLED;
    // A rim under the impulse of the floor.
    let rim = |k: usize, floor: f32| {
        let motor = &motors[k];
        let was = from.rims[k];
        let free = weight[k] * was + dt * (motor.push - motor.damping * was) - floor;
        let friction = motor.friction(was) * dt;
        if free.abs() <= friction {
            0.0
        } else {
            (free - friction.copysign(free)) * per_weight[k]
        }
    };
    let limits = [0, 1].map(|k: usize| train.grip * build.mass_kg * grip[k]);
    let mut floor = [Vec2::default(); 2];
    let mut speeds = from;
    let mut held = [true; 2];
    for _ in 0..SWEEPS {
        let mut largest = 0.0_f32;
        for k in 0..2 {
            let side = if k == 0 { -1.0 } else { 1.0 };
            let slip = rim(k, floor[k].x) - speeds.ground()[k];
            let asked = Vec2::new(
                floor[k].x + slip * scale[k],
                floor[k].y - (speeds.lateral - bend) * build.mass_kg * 0.5,
            );
            let square = asked.dot(asked);
            held[k] = square <= limits[k] * limits[k];
            let taken = if held[k] {
                asked
            } else {
                asked.times(limits[k] / square.sqrt())
            };
            let change = taken.minus(floor[k]);
            floor[k] = taken;
            largest = largest.max(change.x.abs()).max(change.y.abs());
            speeds.longitudinal += change.x * per_mass;
            speeds.yaw += side * change.x * per_turn;
            speeds.lateral += change.y * per_mass;
        }
        for stop in &mut *stops {
            let speed = speeds.longitudinal * stop.normal.x + speeds.lateral * stop.normal.y;
            let taken = (stop.taken + stop.least - speed).max(0.0);
            let change = taken - stop.taken;
            stop.taken = taken;
            speeds.longitudinal += change * stop.normal.x;
            speeds.lateral += change * stop.normal.y;
            largest = largest.max(change.abs() * build.mass_kg);
        }
        if largest < settled {
            break;
        }
    }
    let ground = speeds.ground();
    let mut rolls = held[0] && held[1];
    for k in 0..2 {
        speeds.rims[k] = rim(k, floor[k].x);
        rolls &= (speeds.rims[k] - ground[k]).abs() < ROLLING;
    }
    rolls &= (speeds.lateral - bend).abs() < ROLLING;
    if rolls {
        // Rims are what rolling goes by; a body that stands on standing wheels stands.
        let [left, right] = speeds.rims;
        speeds.longitudinal = (left + right) * 0.5;
        speeds.yaw = (right - left) * 0.5;
        speeds.lateral = bend;
    }
    (speeds, rolls)
}
