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
    /// For how many steps an agent keeps to an action, on average, in the first round; 1 is to choose anew at every step.
    /// Who chooses by chance again and again stays where it is; who keeps to what it chose gets somewhere (Dabney,
    /// Ostrovski and Barreto 2021). How long is drawn step by step, so the policy need not know of it.
    pub hold: f32,
    /// Part of the rounds over which that falls to 1, in a straight line: from then on the agent acts as it will once
    /// learning is over.
    pub held_until: f32,
    /// How strongly the gradient pulls back to the weights that were [adopted](super::Ppo::adopt) last: the proximal term μ
    /// of `FedProx` (Li and others 2020); 0 for not at all.
    pub proximal: f32,
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
            hold: 1.0,
            held_until: 0.5,
            proximal: 0.0,
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
        check(divergence, "divergence", "0, or above")?;
        check((1.0..=1_000.0).contains(&self.hold), "hold", "1 to 1,000")?;
        let until = self.held_until > 0.0 && self.held_until <= 1.0;
        check(until, "held_until", "above 0, at most 1")?;
        check((0.0..=10.0).contains(&self.proximal), "proximal", "0 to 10")
    }

    /// For how many steps an agent keeps to an action, on average, in this round.
    pub(super) fn held(&self, round: u64) -> f32 {
        let gone = round as f64 / (self.rounds as f64 * f64::from(self.held_until));
        (1.0 + (f64::from(self.hold) - 1.0) * (1.0 - gone).max(0.0)) as f32
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
        // A run without it is the one that it was before there was any.
        if self.hold > 1.0 {
            writer.f32s(&[self.hold, self.held_until]);
        }
        if self.proximal > 0.0 {
            writer.f32s(&[self.proximal]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_kept_to_for_less_and_less_time() {
        let config = Config {
            rounds: 8,
            hold: 9.0,
            ..Config::default()
        };
        let held: Vec<f32> = (0..6).map(|round| config.held(round)).collect();
        assert_eq!(held, [9.0, 7.0, 5.0, 3.0, 1.0, 1.0]);
        assert_eq!(Config::default().held(0).to_bits(), 1.0_f32.to_bits());
    }
}
