//! Motors, wheels, room and pack.

use crawler_app::Geometry;
use rand_pcg::Pcg32;

use super::{Bridge, normal, uniform};

/// Width and depth of the room, metres. Its middle is the origin.
pub const ROOM_M: [f32; 2] = [4.0, 3.0];
/// Radius of the round body, metres.
const RADIUS_M: f32 = 0.085;
/// Distance between the wheels, metres.
const TRACK_M: f32 = 0.14;
/// Rim speed for each volt at the motor beyond `RUNNING_V`: yellow 1:48 gear motor, 200 rpm at
/// 6 V, 65 mm wheels: 200 · π · 0.065 m / 60 s / 5.3 V.
const SPEED_PER_VOLT: f32 = 0.128;
/// Volts that friction costs while a wheel turns.
const RUNNING_V: f32 = 0.7;
/// Volts that set a standing wheel in motion.
const BREAKAWAY_V: f32 = 0.9;
/// Volts the bridge keeps for itself.
const BRIDGE_DROP_V: f32 = 1.4;
/// Armature resistance and the slope of the bridge's drop together.
const WINDING_OHM: f32 = 6.6;
/// Time constants of the speed while driven, shorted and open, seconds.
const DRIVEN_TAU_S: f32 = 0.09;
const BRAKE_TAU_S: f32 = 0.04;
const COAST_TAU_S: f32 = 0.18;
/// Share of the way made in one step of 10 ms: 1 − e^(−0.01 / τ).
const DRIVEN_RATE: f32 = 0.105_16;
const BRAKE_RATE: f32 = 0.221_2;
const COAST_RATE: f32 = 0.054_04;
const STEP_S: f32 = 0.01;
/// Slower than this an undriven wheel stands.
const STANDSTILL: f32 = 2e-3;
/// Share of a wheel's speed that goes on as slip when a wall holds the body.
const SLIP_KEPT: f32 = 0.5;

/// Two lithium-ion cells of 2 Ah with their leads.
const CAPACITY_AS: f32 = 2.0 * 3_600.0;
const INTERNAL_OHM: f32 = 0.18;
/// What everything but the motors draws, amperes.
const QUIESCENT_A: f32 = 0.15;
/// Voltage of a cell at rest at 0, 10, … 100 % of its charge.
const CELL_V: [f32; 11] = [
    3.00, 3.35, 3.50, 3.58, 3.64, 3.70, 3.78, 3.87, 3.96, 4.06, 4.20,
];
/// Divider from the pack to the pin.
const UPPER_OHM: f32 = 100_000.0;
const LOWER_OHM: f32 = 47_000.0;
/// Deviation of one conversion, millivolts.
const ADC_NOISE_MV: f32 = 3.0;
/// Highest voltage the converter tells.
const ADC_LIMIT_MV: f32 = 3_100.0;

/// The drive of this body as one would measure it, for the configuration of its program.
pub const GEOMETRY: Geometry = Geometry {
    wheel_base_m: TRACK_M,
    top_speed_mps: (7.4 - BRIDGE_DROP_V - RUNNING_V) * SPEED_PER_VOLT,
    time_constant_s: DRIVEN_TAU_S,
    stiction_duty: RUNNING_V / (7.4 - BRIDGE_DROP_V),
    nominal_v: 7.4,
    bridge_drop_v: BRIDGE_DROP_V,
};

// The rates belong to the time constants: to first order 0.01/τ, less half of its square.
const _: () = {
    let pairs = [
        (DRIVEN_RATE, DRIVEN_TAU_S),
        (BRAKE_RATE, BRAKE_TAU_S),
        (COAST_RATE, COAST_TAU_S),
    ];
    let mut i = 0;
    while i < pairs.len() {
        let x = STEP_S / pairs[i].1;
        assert!(pairs[i].0 < x && pairs[i].0 > x - x * x / 2.0);
        i += 1;
    }
};

/// One motor with its wheel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wheel {
    /// Rim speed, metres per second.
    pub speed: f32,
    /// How this motor differs from the nominal one, 1 for not at all.
    pub strength: f32,
}

impl Wheel {
    /// Turns for one step; returns the current drawn, in amperes.
    pub fn step(&mut self, bridge: Bridge, supply_v: f32) -> f32 {
        let duty = f32::from(bridge.duty) * (1.0 / 255.0);
        let sign = match (bridge.in1, bridge.in2) {
            (true, false) => 1.0,
            (false, true) => -1.0,
            // Both alike short the motor for as long as the enable input is high.
            _ => {
                let rate = COAST_RATE + (BRAKE_RATE - COAST_RATE) * duty;
                self.slow(rate);
                return 0.0;
            }
        };
        let motor_v = duty * (supply_v - BRIDGE_DROP_V).max(0.0);
        let threshold = if self.speed == 0.0 {
            BREAKAWAY_V
        } else {
            RUNNING_V
        };
        if motor_v <= threshold {
            self.slow(COAST_RATE);
            return motor_v / WINDING_OHM * duty;
        }
        let per_volt = SPEED_PER_VOLT * self.strength;
        let goal = sign * (motor_v - RUNNING_V) * per_volt;
        let back_v = sign * self.speed / per_volt;
        self.speed += (goal - self.speed) * DRIVEN_RATE;
        ((motor_v - back_v) / WINDING_OHM).max(0.0) * duty
    }

    fn slow(&mut self, rate: f32) {
        self.speed -= self.speed * rate;
        if self.speed.abs() < STANDSTILL {
            self.speed = 0.0;
        }
    }
}

/// The robot in its room.
#[derive(Debug, Clone)]
pub struct Drive {
    wheels: [Wheel; 2],
    x: f32,
    y: f32,
    theta: f32,
    /// Of the pack, 0 to 1.
    charge: f32,
    pack_v: f32,
}

impl Drive {
    /// Somewhere in the room, at least half a metre from its walls, with a pack nearly full.
    pub(super) fn placed(rng: &mut Pcg32) -> Self {
        let mut strength = || 1.0 + 0.01 * normal(rng);
        let wheels = [strength(), strength()].map(|strength| Wheel {
            speed: 0.0,
            strength,
        });
        let mut within = |span: f32| (uniform(rng) - 0.5) * span;
        let (x, y) = (within(ROOM_M[0] - 1.0), within(ROOM_M[1] - 1.0));
        let theta = within(2.0 * core::f32::consts::PI);
        let charge = 0.9 + within(0.1);
        Self {
            wheels,
            x,
            y,
            theta,
            charge,
            pack_v: at_rest_v(charge),
        }
    }

    /// At a place chosen by a test.
    #[cfg(test)]
    pub(super) fn at(x: f32, y: f32, theta: f32) -> Self {
        use rand_core::SeedableRng;
        Self {
            x,
            y,
            theta,
            ..Self::placed(&mut Pcg32::seed_from_u64(0))
        }
    }

    /// One step of 10 ms.
    pub fn step(&mut self, bridges: &[Bridge; 2]) {
        let mut current = QUIESCENT_A;
        for (wheel, bridge) in self.wheels.iter_mut().zip(bridges) {
            current += wheel.step(*bridge, self.pack_v);
        }
        self.charge = (self.charge - current * (STEP_S / CAPACITY_AS)).max(0.0);
        self.pack_v = (at_rest_v(self.charge) - current * INTERNAL_OHM).max(0.0);
        let [left, right] = self.wheels.map(|wheel| wheel.speed);
        if left == 0.0 && right == 0.0 {
            return;
        }
        let (v, w) = ((left + right) * 0.5, (right - left) * (1.0 / TRACK_M));
        // By the heading in the middle of the step.
        let (sin, cos) = libm::sincosf(self.theta + w * (STEP_S * 0.5));
        let (x, y) = (self.x + v * cos * STEP_S, self.y + v * sin * STEP_S);
        self.theta = wrap(self.theta + w * STEP_S);
        let [limit_x, limit_y] = ROOM_M.map(|side| side * 0.5 - RADIUS_M);
        (self.x, self.y) = (x.clamp(-limit_x, limit_x), y.clamp(-limit_y, limit_y));
        if self.x != x || self.y != y {
            for wheel in &mut self.wheels {
                wheel.speed *= SLIP_KEPT;
            }
        }
    }

    /// Metres from the middle of the room, and radians.
    pub const fn pose(&self) -> [f32; 3] {
        [self.x, self.y, self.theta]
    }

    /// Rim speeds, metres per second.
    pub fn speeds(&self) -> [f32; 2] {
        self.wheels.map(|wheel| wheel.speed)
    }

    /// Voltage of the pack under its load.
    pub const fn pack_v(&self) -> f32 {
        self.pack_v
    }

    /// What the converter tells of the pin between the resistors, in millivolts.
    pub(super) fn gauge_mv(&self, rng: &mut Pcg32) -> u16 {
        let pin = self.pack_v * 1e3 * (LOWER_OHM / (UPPER_OHM + LOWER_OHM));
        let told = pin + normal(rng) * ADC_NOISE_MV;
        (told.clamp(0.0, ADC_LIMIT_MV) + 0.5) as u16
    }

    /// Distance from `ahead` of the middle of the body to the wall in a direction `off` the
    /// heading, and the cosine of the angle at which a ray meets it.
    pub(super) fn wall(&self, ahead: f32, off: f32) -> (f32, f32) {
        let (sin, cos) = libm::sincosf(self.theta);
        let (x, y) = (self.x + ahead * cos, self.y + ahead * sin);
        let (sin, cos) = libm::sincosf(self.theta + off);
        let reach = |at: f32, direction: f32, side: f32| {
            if direction.abs() < 1e-6 {
                f32::INFINITY
            } else {
                (side * 0.5 * direction.signum() - at) / direction
            }
        };
        let (to_x, to_y) = (reach(x, cos, ROOM_M[0]), reach(y, sin, ROOM_M[1]));
        if to_x < to_y {
            (to_x.max(0.0), cos.abs())
        } else {
            (to_y.max(0.0), sin.abs())
        }
    }
}

fn at_rest_v(charge: f32) -> f32 {
    if charge <= 0.0 {
        // The protection circuit opens.
        return 0.0;
    }
    let place = (charge * 10.0).min(10.0);
    let below = (place as usize).min(9);
    2.0 * (CELL_V[below] + (CELL_V[below + 1] - CELL_V[below]) * (place - below as f32))
}

fn wrap(angle: f32) -> f32 {
    use core::f32::consts::PI;
    if angle > PI {
        angle - 2.0 * PI
    } else if angle < -PI {
        angle + 2.0 * PI
    } else {
        angle
    }
}
