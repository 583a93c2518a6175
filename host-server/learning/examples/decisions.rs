//! How fast worlds to learn in are, without a learner: `cargo run --release -p crawler-learning --example decisions`.
//! Actions are drawn evenly, so that episodes end as they may.

use std::error::Error;
use std::sync::Arc;

use cpu_time::ThreadTime;
use crawler_learning::Spread;
use crawler_policy::{Environment, Seed, Status};

const DECISIONS: u32 = 300_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut world = Spread::new(Arc::new(Spread::scenario()?));
    let interface = world.interface();
    let mut actions = vec![0; interface.agents];
    let mut rewards = vec![0.0; interface.agents];
    let mut observation = vec![0.0; interface.observation];
    let (mut decisions, mut episodes, mut state) = (0, 0, 1_u32);
    let begun = ThreadTime::now();
    while decisions < DECISIONS {
        world.reset(Seed::training(1, 0, episodes));
        episodes += 1;
        loop {
            for (agent, action) in actions.iter_mut().enumerate() {
                world.observe(agent, &mut observation);
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *action = ((u64::from(state) * interface.actions as u64) >> 32) as u8;
            }
            decisions += actions.len() as u32;
            if world.step(&actions, &mut rewards) != Status::Running {
                break;
            }
        }
    }
    let rate = f64::from(decisions) / begun.elapsed().as_secs_f64();
    println!("{rate:.0} decisions per second of processor time, {episodes} episodes");
    Ok(())
}
