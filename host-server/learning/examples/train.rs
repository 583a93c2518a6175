//! Trains a policy for robots: `cargo run --release -p crawler-learning --example train -- --out trained`; `--help` has
//! the options.

use std::process::ExitCode;

use clap::Parser;
use crawler_learning::train::{TrainArgs, run};

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    args: TrainArgs,
}

fn main() -> ExitCode {
    run(&Cli::parse().args)
}
