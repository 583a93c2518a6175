//! What a run of PPO is made of.

use crate::checkpoint::Writer;
use crate::config::{ConfigError, Hidden, Shared, check};
use crate::environment::Interface;

/// Whose view the critic has. It is not needed once learning is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Critic {
    /// The agent's own observation.
    Own,
    /// What the environment calls the state: what no robot knows, the places of all of them for one.
    Central,
}

/// What a run of PPO is made of. Together with the environments it determines every byte of the result.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Names the run.
    pub seed: u64,
    /// The policy's network, and the critic's.
    pub hidden: Hidden,
    /// What the critic sees.
    pub critic: Critic,
    /// Rounds of the whole run; the learning rate falls with them.
    pub rounds: u64,
    /// Steps of each environment in a round.
    pub steps: usize,
    /// Samples in a step of the optimiser.
    pub minibatch: usize,
    /// How often each sample is learned from.
    pub epochs: usize,
    /// Learning rate of the first round.
    pub rate: f64,
    /// Learning rate at the end, as a part of that.
    pub final_rate: f64,
    /// Discount of rewards per step.
    pub gamma: f32,
    /// Decay of generalised advantage estimation.
    pub lambda: f32,
    /// How far probabilities may move away in a round.
    pub clip: f32,
    /// Weight of the entropy.
    pub entropy: f32,
    /// Longest gradient of each network.
    pub gradient: f32,
    /// A round ends when the policy has moved so far, as estimated after each epoch; 0 for never.
    pub divergence: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            hidden: Hidden::default(),
            critic: Critic::Own,
            rounds: 100,
            steps: 128,
            minibatch: 2_048,
            epochs: 4,
            rate: 7e-4,
            final_rate: 0.05,
            gamma: 0.995,
            lambda: 0.95,
            clip: 0.2,
            entropy: 0.005,
            gradient: 0.5,
            divergence: 0.03,
        }
    }
}

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
        let state = self.critic == Critic::Own || interface.state > 0;
        check(
            state,
            "critic",
            "`Central` where the environment has a state",
        )?;
        check((1..=100).contains(&self.epochs), "epochs", "1 to 100")?;
        check((0.0..=1.0).contains(&self.lambda), "lambda", "0 to 1")?;
        check(
            self.clip > 0.0 && self.clip < 1.0,
            "clip",
            "between 0 and 1",
        )?;
        check((0.0..=10.0).contains(&self.entropy), "entropy", "0 to 10")?;
        let divergence = self.divergence >= 0.0 && self.divergence.is_finite();
        check(divergence, "divergence", "0, or above")
    }

    pub(crate) fn write(&self, writer: &mut Writer) {
        writer.u64(self.seed);
        self.hidden.write(writer);
        writer.u8(self.critic as u8);
        writer.u64(self.rounds);
        for size in [self.steps, self.minibatch, self.epochs] {
            writer.u64(size as u64);
        }
        for rate in [self.rate, self.final_rate, self.divergence] {
            writer.f64(rate);
        }
        writer.f32s(&[
            self.gamma,
            self.lambda,
            self.clip,
            self.entropy,
            self.gradient,
        ]);
    }
}
