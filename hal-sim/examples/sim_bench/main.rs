//! Measures one simulation and prints its figures, a name and a number to a line.
//!
//! ```text
//! cargo run --release -p crawler-sim --example sim_bench -- lockstep 1000 [WARM-UP-S [SPAN-S]]
//! ```
//!
//! One measurement to a process: what an earlier one has freed would make a later one look as if
//! it needed no memory. `cargo xtask bench sim` runs it for every row of its table.

mod bodies;

use std::error::Error;

use cpu_time::ThreadTime;
use crawler_hal::Duration;
use crawler_sim::scenario::Scenario;
use crawler_sim::tools::bench::{Meter, measure, measure_without_network};

const USAGE: &str = "usage: sim_bench lockstep|none|world ROBOTS [WARM-UP-S [SPAN-S]]";

/// This process.
struct Host(ThreadTime);

impl Meter for Host {
    fn cpu_s(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }

    /// Resident memory, where `/proc` tells it.
    fn memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
        let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
        Some(kib * 1024)
    }

    fn measured(&self, work: &mut dyn FnMut()) {
        measured_part(work);
    }
}

/// Where callgrind begins and stops to count.
#[inline(never)]
fn measured_part(work: &mut dyn FnMut()) {
    work();
    // Something after the call, so that it does not become a jump.
    std::hint::black_box(());
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |place: usize, usual: f64| -> Result<f64, Box<dyn Error>> {
        let Some(text) = arguments.get(place) else {
            return Ok(usual);
        };
        let number: f64 = text
            .parse()
            .map_err(|error| format!("{text:?} is no number: {error}\n{USAGE}"))?;
        if (0.0..=1e6).contains(&number) {
            Ok(number)
        } else {
            Err(format!("{text} is out of range\n{USAGE}").into())
        }
    };
    let seconds = |seconds: f64| Duration::from_micros((seconds * 1e6) as u64);
    let robots = number(1, 1_000.0)? as u32;
    // The initial command has reached everyone by then.
    let warm_up = number(2, 6.0)?;
    // Long enough to measure well, short enough to wait for.
    let span = number(3, (20_000.0 / f64::from(robots.max(1))).clamp(3.0, 60.0))?;
    let host = Host(ThreadTime::now());
    let scenario = || Ok::<_, Box<dyn Error>>(Scenario::built_in("arena")?.with_robots(robots));
    let figures = match arguments.first().map(String::as_str) {
        Some("lockstep") => measure(scenario()?, 1, seconds(warm_up), seconds(span), &host)?,
        Some("none") => {
            measure_without_network(scenario()?, 1, seconds(warm_up), seconds(span), &host)?
        }
        Some("world") => {
            // Some laps of the crowd, so that there is pushing and shoving.
            let steps = (span * 100.0) as u32;
            return bodies::measure(robots as usize, steps.max(1), &host);
        }
        _ => return Err(USAGE.into()),
    };
    println!("robots {}", figures.robots);
    println!("moving {}", figures.moving);
    println!("steps {:.0}", figures.steps_per_cpu_s * figures.cpu_s);
    println!("cpu_s {:.4}", figures.cpu_s);
    println!("steps_per_cpu_s {:.0}", figures.steps_per_cpu_s);
    println!("times_real_time {:.2}", figures.virtual_s / figures.cpu_s);
    println!("spawn_s {:.4}", figures.spawn_s);
    if let Some(bytes) = figures.bytes_per_robot {
        println!("bytes_per_robot {bytes}");
    }
    println!("polls_per_step {:.3}", figures.polls_per_step);
    println!("history {:016x}", figures.history);
    Ok(())
}
