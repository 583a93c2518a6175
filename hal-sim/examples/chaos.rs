//! Breaks everything between a server and its robots, and prints what came of their commands.
//!
//! ```text
//! cargo run --release -p crawler-sim --example chaos -- [ROBOTS [MINUTES [SEED]]]
//! ```

#[path = "../tests/common/chaos.rs"]
mod chaos;

use std::process::ExitCode;

use chaos::Chaos;

fn main() -> ExitCode {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<u64>());
    let mut next = |default| match numbers.next() {
        Some(Ok(number)) => number,
        Some(Err(error)) => {
            eprintln!("not a number: {error}");
            default
        }
        None => default,
    };
    let (robots, minutes, seed) = (next(200), next(30), next(1));
    let report = Chaos::new(robots as u32, seed, false).run(minutes * 60_000);
    println!("{report}");
    let good = report.must_be_zero().iter().all(|(_, count)| *count == 0);
    if good {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
