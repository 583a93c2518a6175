//! What a run of DQN is made of.

use crate::checkpoint::Writer;
use crate::config::{ConfigError, Hidden, Shared, check};
use crate::environment::Interface;

/// What a run of DQN is made of. Together with the environments it determines every byte of the result.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Names the run.
    pub seed: u64,
    /// The network.
    pub hidden: Hidden,
    /// Rounds of the whole run; the learning rate falls with them.
    pub rounds: u64,
    /// Steps of each environment in a round.
    pub steps: usize,
    /// Steps of the optimiser in a round.
    pub updates: usize,
    /// Samples in each of them.
    pub minibatch: usize,
    /// Steps of an agent that are kept to learn from.
    pub memory: usize,
    /// As many have to be there before learning begins.
    pub warm_up: usize,
    /// Rewards that are summed before an estimate takes their place.
    pub horizon: usize,
    /// Rounds over which the part of actions by chance falls from all to [`exploration`](Self::exploration).
    pub exploring: u64,
    /// That part from then on.
    pub exploration: f32,
    /// Steps of the optimiser from one copy of the network, which estimates are taken from, to the next.
    pub target: u64,
    /// Learning rate of the first round.
    pub rate: f64,
    /// Learning rate at the end, as a part of that.
    pub final_rate: f64,
    /// Discount of rewards per step.
    pub gamma: f32,
    /// Longest gradient.
    pub gradient: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            hidden: Hidden::default(),
            rounds: 4_000,
            steps: 16,
            updates: 8,
            minibatch: 128,
            memory: 100_000,
            warm_up: 2_000,
            horizon: 3,
            exploring: 1_000,
            exploration: 0.05,
            target: 500,
            rate: 5e-4,
            final_rate: 0.05,
            gamma: 0.99,
            gradient: 10.0,
        }
    }
}

/// Most numbers that a memory holds: 4 GB of them.
const NUMBERS: usize = 1 << 30;

impl Config {
    /// Checks it against `interface` and the number of environments.
    pub(crate) fn validate(
        &self,
        interface: &Interface,
        environments: usize,
    ) -> Result<(), ConfigError> {
        let shared = Shared {
            hidden: &self.hidden,
            rounds: self.rounds,
            steps: self.steps,
            minibatch: self.minibatch,
            rate: self.rate,
            final_rate: self.final_rate,
            gamma: self.gamma,
            gradient: self.gradient,
        };
        shared.validate(interface, environments)?;
        check(
            (1..=65_536).contains(&self.updates),
            "updates",
            "1 to 65,536",
        )?;
        let memory = self
            .memory
            .checked_mul(2 * interface.observation)
            .is_some_and(|numbers| (1..=NUMBERS).contains(&numbers));
        check(memory, "memory", "at least 1, at most 2³⁰ numbers observed")?;
        let warm_up = (1..=self.memory).contains(&self.warm_up);
        check(warm_up, "warm_up", "1 to all of the memory")?;
        check((1..=100).contains(&self.horizon), "horizon", "1 to 100")?;
        check(
            (0.0..=1.0).contains(&self.exploration),
            "exploration",
            "0 to 1",
        )?;
        check(self.target > 0, "target", "at least 1")
    }

    pub(crate) fn write(&self, writer: &mut Writer) {
        writer.u64(self.seed);
        self.hidden.write(writer);
        let sizes = [
            self.steps,
            self.updates,
            self.minibatch,
            self.memory,
            self.warm_up,
            self.horizon,
        ];
        for size in sizes {
            writer.u64(size as u64);
        }
        for count in [self.rounds, self.exploring, self.target] {
            writer.u64(count);
        }
        writer.f64(self.rate);
        writer.f64(self.final_rate);
        writer.f32s(&[self.exploration, self.gamma, self.gradient]);
    }
}
