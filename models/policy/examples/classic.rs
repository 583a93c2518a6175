//! Learns tasks that everybody knows: `cargo run --release -p crawler-policy --example classic
//! ppo|dqn cartpole|acrobot [SEED] [THREADS]`. Prints the curve, then what the policy comes to on 100 episodes that
//! it never saw.

#[path = "../tests/environments/mod.rs"]
#[allow(dead_code)]
mod environments;
#[path = "../tests/tasks.rs"]
#[allow(dead_code)]
mod tasks;

use std::error::Error;
use std::num::NonZeroUsize;

use crawler_policy::{Compute, Environment, Episode, Policy};
use environments::{acrobot::Acrobot, cartpole::CartPole};

fn mean(episodes: &[Episode]) -> f32 {
    episodes.iter().map(|episode| episode.reward).sum::<f32>() / episodes.len() as f32
}

fn ppo<E: Environment + Default>(
    config: &crawler_policy::ppo::Config,
    compute: Compute,
) -> Result<Policy, Box<dyn Error>> {
    let mut run = tasks::ppo::<E>(config.clone(), compute)?;
    while run.rounds() < config.rounds {
        let report = run.round()?;
        println!(
            "{:>8} steps  reward {:>7.1}  entropy {:.3}  divergence {:.4}  clipped {:.3}  critic {:.3}",
            report.agent_steps,
            mean(&report.episodes),
            report.entropy,
            report.divergence,
            report.clipped,
            report.value_loss
        );
    }
    Ok(run.policy())
}

fn dqn<E: Environment + Default>(
    config: &crawler_policy::dqn::Config,
    compute: Compute,
) -> Result<Policy, Box<dyn Error>> {
    let mut run = tasks::dqn::<E>(config.clone(), compute)?;
    let mut episodes = Vec::new();
    while run.rounds() < config.rounds {
        let report = run.round()?;
        episodes.extend(report.episodes);
        if report.round % (config.rounds / 20) == 0 {
            println!(
                "{:>8} steps  reward {:>7.1}  by chance {:.3}  loss {:.4}  value {:.2}",
                report.agent_steps,
                mean(&episodes),
                report.exploration,
                report.loss.unwrap_or(f64::NAN),
                report.value.unwrap_or(f64::NAN)
            );
            episodes.clear();
        }
    }
    Ok(run.policy())
}

fn evaluate<E: Environment + Default>(policy: &Policy, compute: &Compute) {
    let episodes = policy.evaluate(crawler_policy::Choice::Best, compute, 0..100, E::default);
    let solved = episodes.iter().filter(|episode| episode.succeeded).count();
    println!(
        "never seen: reward {:.1}, {solved} of 100 succeeded",
        mean(&episodes)
    );
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |place: usize| {
        arguments
            .get(place)
            .map_or(Ok(1), |text| text.parse::<u64>())
    };
    let (seed, threads) = (number(2)?, NonZeroUsize::new(number(3)? as usize));
    let compute = Compute::new(threads.unwrap_or(NonZeroUsize::MIN));
    let words: Vec<&str> = arguments.iter().take(2).map(String::as_str).collect();
    match words[..] {
        ["ppo", "cartpole"] => evaluate::<CartPole>(
            &ppo::<CartPole>(&tasks::ppo_cartpole(seed), compute)?,
            &compute,
        ),
        ["ppo", "acrobot"] => evaluate::<Acrobot>(
            &ppo::<Acrobot>(&tasks::ppo_acrobot(seed), compute)?,
            &compute,
        ),
        ["dqn", "cartpole"] => evaluate::<CartPole>(
            &dqn::<CartPole>(&tasks::dqn_cartpole(seed), compute)?,
            &compute,
        ),
        ["dqn", "acrobot"] => evaluate::<Acrobot>(
            &dqn::<Acrobot>(&tasks::dqn_acrobot(seed), compute)?,
            &compute,
        ),
        _ => return Err("ppo|dqn cartpole|acrobot [SEED] [THREADS]".into()),
    }
    Ok(())
}
