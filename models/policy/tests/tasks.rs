//! Configurations that solve what everybody knows.

use crawler_policy::dqn::{self, Dqn};
use crawler_policy::ppo::{self, Ppo};
use crawler_policy::{Activation, Compute, ConfigError, Environment, Hidden};

/// A run of PPO in eight environments.
pub(crate) fn ppo<E: Environment + Default>(
    config: ppo::Config,
    compute: Compute,
) -> Result<Ppo<E>, ConfigError> {
    Ppo::new(config, compute, (0..8).map(|_| E::default()).collect())
}

/// A run of DQN in four environments.
pub(crate) fn dqn<E: Environment + Default>(
    config: dqn::Config,
    compute: Compute,
) -> Result<Dqn<E>, ConfigError> {
    Dqn::new(config, compute, (0..4).map(|_| E::default()).collect())
}

pub(crate) fn ppo_cartpole(seed: u64) -> ppo::Config {
    ppo::Config {
        seed,
        rounds: 80,
        steps: 128,
        minibatch: 256,
        epochs: 10,
        rate: 1e-3,
        final_rate: 0.0,
        gamma: 0.98,
        lambda: 0.9,
        entropy: 0.0,
        divergence: 0.0,
        ..ppo::Config::default()
    }
}

pub(crate) fn ppo_acrobot(seed: u64) -> ppo::Config {
    ppo::Config {
        seed,
        rounds: 100,
        steps: 256,
        minibatch: 256,
        epochs: 4,
        rate: 1e-3,
        final_rate: 0.0,
        gamma: 0.99,
        lambda: 0.94,
        entropy: 0.01,
        divergence: 0.0,
        ..ppo::Config::default()
    }
}

pub(crate) fn dqn_cartpole(seed: u64) -> dqn::Config {
    dqn::Config {
        seed,
        rounds: 8_000,
        exploration: 0.02,
        target: 500,
        gamma: 0.98,
        ..dqn::Config::default()
    }
}

pub(crate) fn dqn_acrobot(seed: u64) -> dqn::Config {
    dqn::Config {
        seed,
        hidden: Hidden {
            units: vec![128, 128],
            activation: Activation::Relu,
        },
        rounds: 8_000,
        steps: 4,
        updates: 4,
        memory: 50_000,
        exploring: 1_500,
        exploration: 0.03,
        target: 500,
        rate: 1e-3,
        ..dqn::Config::default()
    }
}
