//! Tasks that everybody knows, held against those of others over standard input and output; the tests of `python/` start
//! it.
//!
//! | arguments | |
//! |---|---|
//! | `serve cartpole\|acrobot` | the task as it is here, by the protocol of `crawler_policy::gym` |
//! | `ppo\|dqn cartpole\|acrobot [SEED]` | learns the task as it is here, and drives 100 episodes of the one elsewhere |
//!
//! Elsewhere an episode is begun by `r` and its number as `u32`, little-endian, and gone on with by `s` and the action.
//! The answer is what is observed and the reward, as `f32`, and a byte: 0 goes on, 1 has ended, 2 was broken off.

#[path = "../tests/environments/mod.rs"]
#[allow(dead_code)]
mod environments;
#[path = "../tests/tasks.rs"]
#[allow(dead_code)]
mod tasks;

use std::error::Error;
use std::io::{self, Read as _, Write as _, stdin, stdout};
use std::num::NonZeroUsize;

use crawler_policy::gym;
use crawler_policy::{Choice, Compute, Environment, Interface, Policy, Seed, Status};
use environments::{acrobot::Acrobot, cartpole::CartPole};

const EPISODES: u32 = 100;

/// An environment with whoever has the other ends.
struct Elsewhere {
    interface: Interface,
    observed: Vec<f32>,
    reward: f32,
    status: Status,
}

impl Elsewhere {
    fn like(here: &impl Environment) -> Self {
        let interface = here.interface();
        Self {
            interface,
            observed: vec![0.0; interface.observation],
            reward: 0.0,
            status: Status::Terminated,
        }
    }

    fn ask(&mut self, asked: &[u8]) -> io::Result<()> {
        let mut out = stdout().lock();
        out.write_all(asked)?;
        out.flush()?;
        let mut bytes = vec![0; 4 * (self.observed.len() + 1) + 1];
        stdin().lock().read_exact(&mut bytes)?;
        let mut values = bytes.chunks_exact(4).map(|bytes| {
            let bytes = bytes.first_chunk().copied().unwrap_or_default();
            f32::from_le_bytes(bytes)
        });
        for (observed, value) in self.observed.iter_mut().zip(&mut values) {
            *observed = value;
        }
        self.reward = values.next().unwrap_or_default();
        self.status = match bytes.last() {
            Some(0) => Status::Running,
            Some(2) => Status::Truncated,
            _ => Status::Terminated,
        };
        Ok(())
    }

    /// As [`Self::ask`]; whoever does not answer ends the episode.
    fn told(&mut self, asked: &[u8]) {
        if let Err(error) = self.ask(asked) {
            eprintln!("nobody is there: {error}");
            self.status = Status::Terminated;
        }
    }
}

impl Environment for Elsewhere {
    fn interface(&self) -> Interface {
        self.interface
    }

    fn reset(&mut self, seed: Seed) {
        let [a, b, c, d] = (seed.get() as u32).to_le_bytes();
        self.told(&[b'r', a, b, c, d]);
    }

    fn observe(&self, _agent: usize, out: &mut [f32]) {
        out.copy_from_slice(&self.observed);
    }

    fn state(&self, _agent: usize, _out: &mut [f32]) {}

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        self.told(&[b's', actions[0]]);
        rewards[0] = self.reward;
        self.status
    }

    fn succeeded(&self) -> bool {
        false
    }
}

fn serve<E: Environment + Default>(name: &str) -> Result<(), Box<dyn Error>> {
    let one = NonZeroUsize::MIN;
    let (input, output) = (stdin().lock(), stdout().lock());
    Ok(gym::serve(name, one, E::default, one, input, output)?)
}

fn judge<E: Environment + Default>(policy: &Policy, compute: &Compute) {
    let make = || Elsewhere::like(&E::default());
    policy.evaluate(Choice::Best, compute, 0..EPISODES, make);
}

fn ppo<E: Environment + Default>(
    config: &crawler_policy::ppo::Config,
    compute: Compute,
) -> Result<(), Box<dyn Error>> {
    let mut run = tasks::ppo::<E>(config.clone(), compute)?;
    while run.rounds() < config.rounds {
        run.round()?;
    }
    judge::<E>(&run.policy(), &compute);
    Ok(())
}

fn dqn<E: Environment + Default>(
    config: &crawler_policy::dqn::Config,
    compute: Compute,
) -> Result<(), Box<dyn Error>> {
    let mut run = tasks::dqn::<E>(config.clone(), compute)?;
    while run.rounds() < config.rounds {
        run.round()?;
    }
    judge::<E>(&run.policy(), &compute);
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().take(2).map(String::as_str).collect();
    let seed = arguments.get(2).map_or(Ok(1), |text| text.parse())?;
    // One who asks at a time.
    let compute = Compute::new(NonZeroUsize::MIN);
    match words[..] {
        ["serve", "cartpole"] => serve::<CartPole>("cartpole"),
        ["serve", "acrobot"] => serve::<Acrobot>("acrobot"),
        ["ppo", "cartpole"] => ppo::<CartPole>(&tasks::ppo_cartpole(seed), compute),
        ["ppo", "acrobot"] => ppo::<Acrobot>(&tasks::ppo_acrobot(seed), compute),
        ["dqn", "cartpole"] => dqn::<CartPole>(&tasks::dqn_cartpole(seed), compute),
        ["dqn", "acrobot"] => dqn::<Acrobot>(&tasks::dqn_acrobot(seed), compute),
        _ => Err("serve|ppo|dqn cartpole|acrobot [SEED]".into()),
    }
}
