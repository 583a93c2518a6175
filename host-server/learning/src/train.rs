//! `terracrawler train`: a policy for robots, from nothing.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::{Args, ValueEnum};
use crawler_sim::world::Profile;

use crate::curve::Line;
use crate::error::RunError;
use crate::run::{Options, Run};
use crate::spread::Spread;

/// Options of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Folder for what comes of it; a run whose checkpoint is there goes on
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Names the run: the same seed and options come to the same bytes
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Decisions of all robots to learn from
    #[arg(long, value_name = "N", default_value_t = 4_000_000, value_parser = clap::value_parser!(u64).range(1..=10_000_000_000))]
    pub steps: u64,
    /// Worlds side by side
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u16).range(1..=4_096))]
    pub worlds: u16,
    /// Units of both hidden layers of the network
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u16).range(4..=64))]
    pub units: u16,
    /// How far the parameters of each world differ from the nominal ones
    #[arg(long, value_enum, value_name = "PROFILE", default_value = "none")]
    pub randomisation: Randomisation,
    /// The critic sees what a robot observes, and no more
    #[arg(long)]
    pub own_critic: bool,
    /// Threads; they change nothing but the time it takes [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

/// Profiles of randomisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Randomisation {
    /// None
    None,
    /// As robots of one make in one room differ
    Mild,
    /// As far as a policy should still cope with
    Wild,
}

impl Randomisation {
    pub(crate) const fn profile(self) -> Profile {
        match self {
            Self::None => Profile::None,
            Self::Mild => Profile::Mild,
            Self::Wild => Profile::Wild,
        }
    }
}

/// Trains. 2 when the options cannot be used, 1 when it comes to nothing.
#[must_use]
pub fn run(args: &TrainArgs) -> ExitCode {
    match train(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("terracrawler: {error}");
            ExitCode::from(match error {
                RunError::Diverged(_) | RunError::Unfit(_) | RunError::Weights(_) => 1,
                RunError::File(..)
                | RunError::Config(_)
                | RunError::Checkpoint(..)
                | RunError::Rounds(..)
                | RunError::Settings(_)
                | RunError::Plan(_) => 2,
            })
        }
    }
}

fn train(args: &TrainArgs) -> Result<(), RunError> {
    let mut scenario = Spread::scenario().unwrap_or_else(|error| unreachable!("{error}"));
    scenario.randomisation = args.randomisation.profile();
    let options = Options {
        seed: args.seed,
        steps: args.steps,
        worlds: usize::from(args.worlds),
        units: usize::from(args.units),
        privileged: !args.own_critic,
    };
    let threads = args.threads.map_or_else(
        || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
        |threads| NonZeroUsize::new(usize::from(threads)).unwrap_or(NonZeroUsize::MIN),
    );
    let mut run = Run::open(&options, &args.out, scenario, threads)?;
    let (done, rounds) = run.rounds();
    if done > 0 {
        println!("goes on after round {done} of {rounds}");
    }
    println!("round     steps  reward  success  decisions  entropy  divergence  steps/s");
    let begun = Instant::now();
    let mut first = None;
    while let Some(line) = run.round()? {
        let own = line.steps / line.round;
        let from = *first.get_or_insert(line.steps - own);
        let rate = (line.steps - from) as f64 / begun.elapsed().as_secs_f64();
        if line.round.is_multiple_of(5) || line.round == rounds {
            tell(&line, rate);
        }
    }
    let summary = run.finish()?;
    println!("on worlds that nobody learned from, in the bare world:");
    for (what, judged) in [("floats", summary.floats), ("int8", summary.whole)] {
        println!(
            "  {what:<6} {:>5.1} % apart without touching anything, after {:.1} s",
            judged.success * 100.0,
            judged.length * 0.1
        );
    }
    let path = args.out.join("policy.tcpo");
    println!("{}: {} bytes", path.display(), summary.blob.len());
    Ok(())
}

fn tell(line: &Line, rate: f64) {
    println!(
        "{:>5} {:>9}  {:>6.2}  {:>5.1} %  {:>9.0}  {:>7.3}  {:>10.4}  {rate:>7.0}",
        line.round,
        line.steps,
        line.reward,
        line.success * 100.0,
        line.length,
        line.entropy,
        line.divergence
    );
}
