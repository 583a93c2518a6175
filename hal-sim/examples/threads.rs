//! Measures one world on several threads, and prints a table in Markdown.
//!
//! ```text
//! cargo run --release -p crawler-sim --example threads -- [ROBOTS [THREADS…]]
//! ```

use std::error::Error;
use std::time::Instant;

use cpu_time::ThreadTime;
use crawler_hal::Duration;
use crawler_sim::run::parallel::{Clocks, Plan, measure};
use crawler_sim::scenario::Scenario;

struct Host(Instant);

impl Clocks for Host {
    fn wall_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }

    fn thread_cpu_s(&self) -> f64 {
        ThreadTime::now().as_duration().as_secs_f64()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut numbers = Vec::new();
    for text in std::env::args().skip(1) {
        let number: u32 = text
            .parse()
            .map_err(|error| format!("{text:?} is no number: {error}"))?;
        numbers.push(number);
    }
    let robots = numbers.first().copied().unwrap_or(1_000);
    let threads = match numbers.get(1..) {
        Some(threads) if !threads.is_empty() => threads.to_vec(),
        _ => vec![1, 2],
    };
    let scenario = Scenario::built_in("arena")?.with_robots(robots);
    let span = (20_000 / u64::from(robots.max(1))).clamp(3, 60);
    println!(
        "| robots | threads | robots × steps per second | per CPU-second | CPU per second | as fast as the first |"
    );
    println!("|---:|---:|---:|---:|---:|---:|");
    let mut first: Option<(f64, u64)> = None;
    for threads in threads {
        let plan = Plan {
            scenario: &scenario,
            seed: 1,
            network: true,
            threads: threads as usize,
            span: Duration::from_secs(span),
        };
        let pace = measure(&plan, Duration::from_secs(6), &Host(Instant::now()))?;
        let (base, history) = *first.get_or_insert((pace.steps_per_s, pace.history));
        if pace.history != history {
            return Err(format!("{threads} threads gave another history").into());
        }
        println!(
            "| {robots} | {threads} | {:.0} | {:.0} | {:.2} | {:.2} |",
            pace.steps_per_s,
            pace.steps_per_cpu_s,
            pace.cpu_s.iter().sum::<f64>() / pace.wall_s,
            pace.steps_per_s / base,
        );
    }
    Ok(())
}
