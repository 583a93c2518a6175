//! Short runs of either algorithm, alike.

use std::num::NonZeroUsize;

use crawler_policy::dqn::{self, Dqn};
use crawler_policy::ppo::{self, Critic, Ppo};
use crawler_policy::{CheckpointError, Compute, Environment, Hidden};

use crate::environments::cartpole::CartPole;
use crate::environments::pair::Pair;

/// A run, whatever learns in it.
pub(crate) trait Run {
    /// Acts and learns; what is reported, as text.
    fn round(&mut self) -> String;
    fn checkpoint(&self) -> Vec<u8>;
    fn resume(&mut self, checkpoint: &[u8]) -> Result<(), CheckpointError>;
    fn policy(&self) -> Vec<u8>;
}

macro_rules! run {
    ($name:ident) => {
        impl<E: Environment> Run for $name<E> {
            fn round(&mut self) -> String {
                format!("{:?}", $name::round(self).expect("finite"))
            }

            fn checkpoint(&self) -> Vec<u8> {
                $name::checkpoint(self)
            }

            fn resume(&mut self, checkpoint: &[u8]) -> Result<(), CheckpointError> {
                $name::resume(self, checkpoint)
            }

            fn policy(&self) -> Vec<u8> {
                $name::policy(self).to_bytes()
            }
        }
    };
}

run!(Ppo);
run!(Dqn);

/// Networks whose layers fill no vector.
fn hidden() -> Hidden {
    Hidden {
        units: vec![20, 12],
        ..Hidden::default()
    }
}

/// Many minibatches, the last of them short; more pieces than threads.
fn ppo_config(critic: Critic) -> ppo::Config {
    ppo::Config {
        hidden: hidden(),
        critic,
        rounds: 10,
        steps: 100,
        minibatch: 700,
        epochs: 2,
        ..ppo::Config::default()
    }
}

fn dqn_config() -> dqn::Config {
    dqn::Config {
        hidden: hidden(),
        rounds: 10,
        steps: 60,
        updates: 7,
        minibatch: 600,
        memory: 1_000,
        warm_up: 500,
        target: 5,
        ..dqn::Config::default()
    }
}

/// How to begin a run.
pub(crate) type Begin = fn(Compute) -> Box<dyn Run>;

/// Runs of both algorithms; seven environments, which no number of threads divides.
pub(crate) const RUNS: [(&str, Begin); 5] = [
    ("ppo", |compute| {
        let environments = (0..7).map(|_| CartPole::default()).collect();
        let run = Ppo::new(ppo_config(Critic::Own), compute, environments);
        Box::new(run.expect("a configuration"))
    }),
    ("ppo with a central critic", |compute| {
        let environments = (0..7).map(|_| Pair::default()).collect();
        let run = Ppo::new(ppo_config(Critic::Central), compute, environments);
        Box::new(run.expect("a configuration"))
    }),
    ("ppo that keeps to its actions", |compute| {
        let environments = (0..7).map(|_| Pair::default()).collect();
        let config = ppo::Config {
            seed: 2,
            hold: 5.0,
            ..ppo_config(Critic::Central)
        };
        let run = Ppo::new(config, compute, environments);
        Box::new(run.expect("a configuration"))
    }),
    ("dqn", |compute| {
        let environments = (0..7).map(|_| CartPole::default()).collect();
        let run = Dqn::new(dqn_config(), compute, environments);
        Box::new(run.expect("a configuration"))
    }),
    ("dqn of two agents", |compute| {
        let environments = (0..7).map(|_| Pair::default()).collect();
        let run = Dqn::new(dqn_config(), compute, environments);
        Box::new(run.expect("a configuration"))
    }),
];

/// So many threads.
pub(crate) fn threads(count: usize) -> Compute {
    Compute::new(NonZeroUsize::new(count).expect("threads"))
}
