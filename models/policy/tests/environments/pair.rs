//! Two agents on a line, each of which knows its own place and on which side the other one is, and who should
//! meet. The state is both places.

use crawler_policy::{Environment, Interface, Seed, Status};

const PLACES: f64 = 10.0;
const STEPS: u32 = 40;

/// Both places, and the steps taken.
#[derive(Debug, Default)]
pub(crate) struct Pair {
    places: [i32; 2],
    steps: u32,
}

impl Environment for Pair {
    fn interface(&self) -> Interface {
        Interface {
            agents: 2,
            observation: 2,
            state: 2,
            actions: 3,
        }
    }

    fn reset(&mut self, seed: Seed) {
        self.places = super::draws(seed).map(|draw| ((draw + 1.0) * (PLACES / 2.0)) as i32);
        self.steps = 0;
    }

    fn observe(&self, agent: usize, out: &mut [f32]) {
        let (own, other) = (self.places[agent], self.places[1 - agent]);
        out.copy_from_slice(&[own as f32 / PLACES as f32, (other - own).signum() as f32]);
    }

    fn state(&self, agent: usize, out: &mut [f32]) {
        let both = [self.places[agent], self.places[1 - agent]];
        out.copy_from_slice(&both.map(|place| place as f32 / PLACES as f32));
    }

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        for (place, action) in self.places.iter_mut().zip(actions) {
            *place = (*place + i32::from(*action) - 1).clamp(0, PLACES as i32 - 1);
        }
        self.steps += 1;
        let met = self.succeeded();
        rewards.fill(if met { 1.0 } else { -0.05 });
        if met {
            Status::Terminated
        } else if self.steps == STEPS {
            Status::Truncated
        } else {
            Status::Running
        }
    }

    fn succeeded(&self) -> bool {
        self.places[0] == self.places[1]
    }
}
