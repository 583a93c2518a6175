//! What is learned in: worlds with one or more agents that act at once.

use crate::random::mix;

/// The numbers that tell how a world and those who learn in it meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interface {
    /// Agents in one environment. All of them share one policy.
    pub agents: usize,
    /// Numbers that an agent observes. They should be about as large as one.
    pub observation: usize,
    /// Numbers that a privileged critic sees for an agent, in training alone; 0 where there is nothing to see.
    pub state: usize,
    /// How many actions an agent has to choose from.
    pub actions: usize,
}

/// How an episode stands after a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// It goes on.
    Running,
    /// It has come to its end: nothing is gained or lost any more.
    Terminated,
    /// It is broken off, and would have gone on: the return that is missing is estimated.
    Truncated,
}

/// From what an environment draws an episode. Those of training and those of evaluation have nothing in common:
/// the highest bit tells them apart, and no other way to make one exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Seed(u64);

impl Seed {
    const TRAINING: u64 = 1 << 63;

    /// Of an episode of an environment of a training run.
    pub const fn training(run: u64, environment: u32, episode: u32) -> Self {
        let place = (environment as u64) << 32 | episode as u64;
        Self(mix(run ^ mix(place)) | Self::TRAINING)
    }

    /// Of the evaluation episode with this number.
    pub const fn evaluation(number: u32) -> Self {
        Self(number as u64)
    }

    /// As a number.
    pub const fn get(self) -> u64 {
        self.0
    }

    /// Whether it is one of training.
    pub const fn is_training(self) -> bool {
        self.0 & Self::TRAINING != 0
    }
}

/// A world with agents.
///
/// What happens after a [`reset`](Self::reset) follows from its seed and the actions alone. A run that goes on
/// from a checkpoint takes the actions of the running episode again, and relies on that.
pub trait Environment: Send {
    /// Always the same.
    fn interface(&self) -> Interface;

    /// Begins an episode.
    fn reset(&mut self, seed: Seed);

    /// Writes what `agent` observes. Also asked for when an episode has been truncated.
    fn observe(&self, agent: usize, out: &mut [f32]);

    /// Writes what a privileged critic sees for `agent`. Not called where [`Interface::state`] is 0.
    fn state(&self, agent: usize, out: &mut [f32]);

    /// Every agent acts, and gets its reward. Not called after the end of an episode.
    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status;

    /// Whether the episode has reached its goal, when it is over.
    fn succeeded(&self) -> bool;
}

/// What came of an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Episode {
    /// Sum of its rewards, averaged over agents.
    pub reward: f32,
    /// Steps.
    pub length: u32,
    /// Whether it reached its goal.
    pub succeeded: bool,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn no_seed_of_training_is_one_of_evaluation(
            run: u64, environment: u32, episode: u32, number: u32,
        ) {
            let training = Seed::training(run, environment, episode);
            let evaluation = Seed::evaluation(number);
            prop_assert!(training.is_training() && !evaluation.is_training());
            prop_assert_ne!(training.get(), evaluation.get());
        }
    }
}
