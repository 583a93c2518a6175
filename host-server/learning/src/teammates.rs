//! The task for one learner: the first robot of each world learns, the others drive by a policy, as robots do.

use std::sync::Arc;

use crawler_app::policy::{Policy as Blob, choose};
use crawler_policy::{Environment, Interface, Seed, Status};
use crawler_sim::scenario::Scenario;
use rand_core::Rng as _;
use rand_pcg::Pcg32;

use crate::spread::Spread;

/// The task with one learner in each world.
#[derive(Debug, Clone)]
pub struct Teammates<'a> {
    world: Spread,
    policy: Blob<'a>,
    /// What the policy draws its actions by.
    rng: Pcg32,
    actions: Vec<u8>,
    rewards: Vec<f32>,
}

impl<'a> Teammates<'a> {
    /// Robots of `scenario` of which all but the first drive by `policy`.
    pub fn new(scenario: Arc<Scenario>, policy: Blob<'a>) -> Self {
        let world = Spread::new(scenario);
        let robots = world.interface().agents;
        Self {
            world,
            policy,
            rng: draws(0),
            actions: vec![0; robots],
            rewards: vec![0.0; robots],
        }
    }
}

/// What a policy draws by in an episode of this seed.
fn draws(seed: u64) -> Pcg32 {
    Pcg32::new(seed, 0x7465_616D)
}

impl Environment for Teammates<'_> {
    fn interface(&self) -> Interface {
        Interface {
            agents: 1,
            ..self.world.interface()
        }
    }

    fn reset(&mut self, seed: Seed) {
        self.world.reset(seed);
        self.rng = draws(seed.get());
    }

    fn observe(&self, agent: usize, out: &mut [f32]) {
        self.world.observe(agent, out);
    }

    fn state(&self, agent: usize, out: &mut [f32]) {
        self.world.state(agent, out);
    }

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        let rng = &mut self.rng;
        let mut told = actions.iter();
        for (robot, action) in self.actions.iter_mut().enumerate() {
            *action = told.next().copied().unwrap_or_else(|| {
                let observation = self.world.observation(robot);
                choose(&self.policy, &observation, || rng.next_u32() as u8) as u8
            });
        }
        let status = self.world.step(&self.actions, &mut self.rewards);
        for (reward, of_all) in rewards.iter_mut().zip(&self.rewards) {
            *reward = *of_all;
        }
        status
    }

    fn succeeded(&self) -> bool {
        self.world.succeeded()
    }
}
