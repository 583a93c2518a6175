//! A lock that is pulled open after many turns one way, of which one the other way undoes all; to pull before costs a little.
//! Robots have it so: their shield lets them drive once they have looked around.

use crawler_policy::{Environment, Interface, Seed, Status};

/// Turns that open it.
const OPENS: u32 = 13;
/// What there is to do: nothing, a turn either way, a pull.
const ACTIONS: usize = 4;
const PULL: u8 = 3;
const STEPS: u32 = 100;

/// The turns so far, and where to.
#[derive(Debug, Default)]
pub(crate) struct Lock {
    turns: u32,
    towards: u8,
    open: bool,
    steps: u32,
}

impl Environment for Lock {
    fn interface(&self) -> Interface {
        Interface {
            agents: 1,
            observation: 2,
            state: 0,
            actions: ACTIONS,
        }
    }

    fn reset(&mut self, _: Seed) {
        *self = Self::default();
    }

    fn observe(&self, _: usize, out: &mut [f32]) {
        let side = if self.towards == 1 { 1.0 } else { -1.0 };
        let turned = self.turns.min(OPENS) as f32 / OPENS as f32;
        out.copy_from_slice(&[turned, side * turned.min(0.2)]);
    }

    fn state(&self, _: usize, _: &mut [f32]) {}

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        self.steps += 1;
        let mut reward = 0.0;
        match actions[0] {
            PULL if self.turns >= OPENS => {
                self.open = true;
                reward = 1.0;
            }
            // What is in vain costs a little.
            PULL => reward = -0.01,
            towards @ 1..=2 => {
                self.turns = if towards == self.towards {
                    self.turns + 1
                } else {
                    1
                };
                self.towards = towards;
            }
            _ => {}
        }
        rewards[0] = reward;
        if self.open {
            Status::Terminated
        } else if self.steps == STEPS {
            Status::Truncated
        } else {
            Status::Running
        }
    }

    fn succeeded(&self) -> bool {
        self.open
    }
}
