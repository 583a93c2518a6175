//! A pole on a cart (Barto, Sutton and Anderson 1983), with the numbers of `CartPole-v1` of Gymnasium.

use crawler_policy::{Environment, Interface, Seed, Status};

const GRAVITY: f64 = 9.8;
const CART: f64 = 1.0;
const POLE: f64 = 0.1;
/// Half of the pole's length.
const LENGTH: f64 = 0.5;
const FORCE: f64 = 10.0;
const STEP: f64 = 0.02;
const EDGE: f64 = 2.4;
const FALLEN: f64 = 12.0 * core::f64::consts::TAU / 360.0;
const STEPS: u32 = 500;

/// Place, speed, angle, angular speed; and the steps taken.
#[derive(Debug, Default)]
pub(crate) struct CartPole {
    state: [f64; 4],
    steps: u32,
}

impl Environment for CartPole {
    fn interface(&self) -> Interface {
        Interface {
            agents: 1,
            observation: 4,
            state: 4,
            actions: 2,
        }
    }

    fn reset(&mut self, seed: Seed) {
        self.state = super::draws(seed).map(|draw| draw * 0.05);
        self.steps = 0;
    }

    fn observe(&self, _agent: usize, out: &mut [f32]) {
        for (out, value) in out.iter_mut().zip(self.state) {
            *out = value as f32;
        }
    }

    fn state(&self, agent: usize, out: &mut [f32]) {
        self.observe(agent, out);
    }

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        let [place, speed, angle, turn] = self.state;
        let force = if actions[0] == 1 { FORCE } else { -FORCE };
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        let push = (force + POLE * LENGTH * turn * turn * sin) / (CART + POLE);
        let inertia = LENGTH * (4.0 / 3.0 - POLE * cos * cos / (CART + POLE));
        let angular = (GRAVITY * sin - cos * push) / inertia;
        let linear = push - POLE * LENGTH * angular * cos / (CART + POLE);
        self.state = [
            place + STEP * speed,
            speed + STEP * linear,
            angle + STEP * turn,
            turn + STEP * angular,
        ];
        self.steps += 1;
        rewards[0] = 1.0;
        if self.state[0].abs() > EDGE || self.state[2].abs() > FALLEN {
            Status::Terminated
        } else if self.steps == STEPS {
            Status::Truncated
        } else {
            Status::Running
        }
    }

    fn succeeded(&self) -> bool {
        self.steps == STEPS
    }
}
