//! Agent-steps that PPO learns from per second of processor time: `cargo run --release -p crawler-policy
//! --example speed [ROUNDS]`. Policy and critic have 48 inputs and twice 64 units, the policy 16 actions; each
//! sample is learned from four times. The environment costs next to nothing. The first thread also does what only one can
//! do: where processors are free, a run takes as long as it does.

use std::num::NonZeroUsize;
use std::time::Instant;

use cpu_time::{ProcessTime, ThreadTime};
use crawler_policy::ppo::{Config, Ppo};
use crawler_policy::{Compute, Environment, Interface, Seed, Status};

/// Three agents that are told numbers.
#[derive(Debug, Default)]
struct Numbers {
    state: u64,
    steps: u32,
}

impl Environment for Numbers {
    fn interface(&self) -> Interface {
        Interface {
            agents: 3,
            observation: 48,
            state: 0,
            actions: 16,
        }
    }

    fn reset(&mut self, seed: Seed) {
        self.state = seed.get();
        self.steps = 0;
    }

    fn observe(&self, agent: usize, out: &mut [f32]) {
        let state = self.state.rotate_left(agent as u32);
        for (place, out) in out.iter_mut().enumerate() {
            *out = (state >> place & 0xff) as f32 / 128.0 - 1.0;
        }
    }

    fn state(&self, _agent: usize, _out: &mut [f32]) {}

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        for (action, reward) in actions.iter().zip(rewards) {
            *reward = f32::from(u64::from(*action) == self.state >> 60);
        }
        self.state = self
            .state
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add(1);
        self.steps += 1;
        if self.steps == 500 {
            Status::Truncated
        } else {
            Status::Running
        }
    }

    fn succeeded(&self) -> bool {
        false
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let rounds: u64 = std::env::args().nth(1).map_or(Ok(4), |n| n.parse())?;
    let config = Config {
        rounds,
        divergence: 0.0,
        ..Config::default()
    };
    println!(
        "| threads | agent-steps | processor, s | of it the first thread, s | per processor second | wall, s |"
    );
    println!("|---:|---:|---:|---:|---:|---:|");
    let mut first = None;
    for threads in [1, 2] {
        let compute = Compute::new(NonZeroUsize::new(threads).ok_or("no threads")?);
        let environments = (0..64).map(|_| Numbers::default()).collect();
        let mut ppo = Ppo::new(config.clone(), compute, environments)?;
        let (wall, processor, own) = (Instant::now(), ProcessTime::now(), ThreadTime::now());
        for _ in 0..rounds {
            ppo.round()?;
        }
        let (wall, processor, own) = (
            wall.elapsed().as_secs_f64(),
            processor.elapsed().as_secs_f64(),
            own.elapsed().as_secs_f64(),
        );
        let steps = rounds as usize * ppo.samples();
        let speed = steps as f64 / processor;
        println!("| {threads} | {steps} | {processor:.2} | {own:.2} | {speed:.0} | {wall:.2} |");
        let bytes = ppo.policy().to_bytes();
        if first.get_or_insert_with(|| bytes.clone()) != &bytes {
            return Err("threads changed the result".into());
        }
    }
    Ok(())
}
