//! Two links that hang from a joint, driven where they meet (Sutton 1996), with the numbers of `Acrobot-v1` of
//! Gymnasium.

use core::f64::consts::{PI, TAU};

use crawler_policy::{Environment, Interface, Seed, Status};

const GRAVITY: f64 = 9.8;
/// Of both links: mass 1, length 1, moment of inertia 1.
const CENTRE: f64 = 0.5;
const STEP: f64 = 0.2;
const FASTEST: [f64; 2] = [4.0 * PI, 9.0 * PI];
const STEPS: u32 = 500;

/// Both angles, and their speeds; and the steps taken.
#[derive(Debug, Default)]
pub(crate) struct Acrobot {
    state: [f64; 4],
    steps: u32,
    up: bool,
}

/// How the state changes (Sutton and Barto, Reinforcement Learning, section 11.3 of the first edition).
fn change([first, second, speed, other]: [f64; 4], torque: f64) -> [f64; 4] {
    let (sin, cos) = (libm::sin(second), libm::cos(second));
    let d1 = CENTRE * CENTRE + (1.0 + CENTRE * CENTRE + 2.0 * CENTRE * cos) + 2.0;
    let d2 = CENTRE * CENTRE + CENTRE * cos + 1.0;
    let phi2 = CENTRE * GRAVITY * libm::cos(first + second - PI / 2.0);
    let phi1 = -CENTRE * other * other * sin - 2.0 * CENTRE * other * speed * sin
        + (CENTRE + 1.0) * GRAVITY * libm::cos(first - PI / 2.0)
        + phi2;
    let pull = torque + d2 / d1 * phi1 - CENTRE * speed * speed * sin - phi2;
    let second_change = pull / (CENTRE * CENTRE + 1.0 - d2 * d2 / d1);
    [
        speed,
        other,
        -(d2 * second_change + phi1) / d1,
        second_change,
    ]
}

/// An angle from −π to π.
fn wrap(angle: f64) -> f64 {
    angle - TAU * libm::floor((angle + PI) / TAU)
}

impl Environment for Acrobot {
    fn interface(&self) -> Interface {
        Interface {
            agents: 1,
            observation: 6,
            state: 0,
            actions: 3,
        }
    }

    fn reset(&mut self, seed: Seed) {
        self.state = super::draws(seed).map(|draw| draw * 0.1);
        self.steps = 0;
        self.up = false;
    }

    /// Sines and cosines as in Gymnasium; speeds in half turns.
    fn observe(&self, _agent: usize, out: &mut [f32]) {
        let [first, second, speed, other] = self.state;
        let all = [
            libm::cos(first),
            libm::sin(first),
            libm::cos(second),
            libm::sin(second),
            speed / PI,
            other / PI,
        ];
        for (out, value) in out.iter_mut().zip(all) {
            *out = value as f32;
        }
    }

    fn state(&self, _agent: usize, _out: &mut [f32]) {}

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        let torque = f64::from(actions[0]) - 1.0;
        let along = |slope: [f64; 4], step: f64| {
            core::array::from_fn::<f64, 4, _>(|i| self.state[i] + step * slope[i])
        };
        // Runge and Kutta, fourth order.
        let k1 = change(self.state, torque);
        let k2 = change(along(k1, STEP / 2.0), torque);
        let k3 = change(along(k2, STEP / 2.0), torque);
        let k4 = change(along(k3, STEP), torque);
        let slope = core::array::from_fn(|i| (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]) / 6.0);
        let [first, second, speed, other] = along(slope, STEP);
        self.state = [
            wrap(first),
            wrap(second),
            speed.clamp(-FASTEST[0], FASTEST[0]),
            other.clamp(-FASTEST[1], FASTEST[1]),
        ];
        self.steps += 1;
        let [first, second, ..] = self.state;
        self.up = -libm::cos(first) - libm::cos(first + second) > 1.0;
        rewards[0] = if self.up { 0.0 } else { -1.0 };
        if self.up {
            Status::Terminated
        } else if self.steps == STEPS {
            Status::Truncated
        } else {
            Status::Running
        }
    }

    fn succeeded(&self) -> bool {
        self.up
    }
}
