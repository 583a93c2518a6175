//! Measures lockstep simulations and prints a table in Markdown.
//!
//! `cargo run --release -p crawler-sim --example lockstep_bench [robots…]`

use std::error::Error;

use cpu_time::ThreadTime;
use crawler_hal::Duration;
use crawler_sim::run::bench::{Meter, measure, measure_without_network};
use crawler_sim::scenario::Scenario;

/// The process: its time, and whether its memory means anything.
struct Host(ThreadTime, bool);

impl Meter for Host {
    fn cpu_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }

    /// Resident memory, where `/proc` tells it.
    fn memory(&self) -> Option<u64> {
        if !self.1 {
            return None;
        }
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
        let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
        Some(kib * 1024)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut sizes = Vec::new();
    for argument in std::env::args().skip(1) {
        sizes.push(
            argument
                .parse::<u32>()
                .map_err(|error| format!("{argument:?} is no number of robots: {error}"))?,
        );
    }
    if sizes.is_empty() {
        sizes = vec![100, 1_000, 10_000];
    }
    let host = Host(ThreadTime::now(), true);
    // What the run before has freed is not given back: the next one seems to need nothing.
    let later = Host(ThreadTime::now(), false);
    println!(
        "| network | robots | moving | robots × control steps per CPU-second | times real time | bytes per robot | polls per step | history |"
    );
    println!("|---|---:|---:|---:|---:|---:|---:|---|");
    for robots in sizes {
        let scenario = Scenario::built_in("arena")?.with_robots(robots);
        let warm_up = Duration::from_secs(8);
        // Long enough to measure well, short enough to wait for.
        let span = Duration::from_secs((200_000 / u64::from(robots.max(1))).clamp(10, 120));
        for (network, figures) in [
            (
                "lockstep",
                measure(scenario.clone(), 1, warm_up, span, &host)?,
            ),
            (
                "none",
                measure_without_network(scenario, 1, warm_up, span, &later)?,
            ),
        ] {
            println!(
                "| {network} | {} | {} | {:.0} | {:.1} | {} | {:.2} | {:016x} |",
                figures.robots,
                figures.moving,
                figures.steps_per_cpu_s,
                figures.virtual_s / figures.cpu_s,
                figures
                    .bytes_per_robot
                    .map_or_else(|| "unknown".to_owned(), |bytes| bytes.to_string()),
                figures.polls_per_step,
                figures.history,
            );
        }
    }
    Ok(())
}
