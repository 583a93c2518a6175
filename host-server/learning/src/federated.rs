//! Learning together: nodes train the policy of all in worlds of their own, and tell how the weights changed.
//!
//! A node's worlds are its affair: another floor, other things in the way, other motors, other rangers. Nothing of them leaves it but
//! the weights and how it fared. Who coordinates needs no world but those that the policy is judged in.
//!
//! Reading order: `node`, one of many; `coordination`, a run of all of them with its files.

mod coordination;
mod node;

use std::num::NonZeroUsize;
use std::sync::Arc;

use crawler_federated::Plan;
use crawler_policy::ppo::Ppo;
use crawler_policy::{Compute, ConfigError, Policy};

pub use coordination::{Coordination, FederatedOptions};
pub use node::{Answer, Node, NodeError};

use crate::error::RunError;
use crate::run::Options;
use crate::spread::Spread;

fn learner(
    plan: &Plan,
    seed: u64,
    rounds: u32,
    compute: Compute,
    worlds: Vec<Spread>,
) -> Result<Ppo<Spread>, ConfigError> {
    let options = Options {
        seed,
        units: usize::from(plan.units),
        privileged: plan.central,
        ..Options::default()
    };
    let mut config = options.config(u64::from(rounds) * u64::from(plan.rounds));
    config.minibatch = usize::from(plan.minibatch);
    config.proximal = plan.proximal;
    Ppo::new(config, compute, worlds)
}

/// A learner of the plan that never learns, for the form of its networks.
fn idle(plan: &Plan) -> Result<Ppo<Spread>, ConfigError> {
    let scenario = Spread::scenario().unwrap_or_else(|error| unreachable!("{error}"));
    let world = Spread::new(Arc::new(scenario));
    learner(
        plan,
        plan.seed,
        1,
        Compute::new(NonZeroUsize::MIN),
        vec![world],
    )
}

/// The weights from which a run of this plan begins.
///
/// # Errors
/// When no run can be made of the plan.
pub fn initial(plan: &Plan) -> Result<Vec<f32>, RunError> {
    plan.validate()?;
    Ok(idle(plan)?.weights())
}

/// The policy of the weights of a run of this plan.
///
/// # Errors
/// When they are not those of the networks of the plan.
pub fn policy(plan: &Plan, weights: &[f32]) -> Result<Policy, RunError> {
    plan.validate()?;
    let mut ppo = idle(plan)?;
    ppo.adopt(weights, 0)?;
    Ok(ppo.policy())
}
