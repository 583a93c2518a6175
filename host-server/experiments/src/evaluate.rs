//! `terracrawler evaluate`: a scenario on many seeds, and what comes of it.

mod against;
mod compare;
mod hunt;
mod output;
mod progress;
mod provenance;
mod study;

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use crawler_sim::evaluate::{
    Axis, Criterion, Driver, Evaluation, Job, Trial, ideal, run_all, wandering,
};
use crawler_sim::scenario::{Scenario, Threshold, Trained};

use crawler_system::cli_error::{CliError, OrSay as _};

use crate::scenarios::{self, Changes, Randomisation, quoted};
use against::Other;
use compare::Baseline;
use output::{can_write, explain, write_file};
use progress::Progress;
use provenance::Provenance;

/// Most runs of one evaluation.
const MOST_RUNS: u64 = 1_000_000;
/// Most runs with parameters of their own: each has a scenario of its own until the end.
const MOST_DRAWN: u64 = 100_000;
/// Least and most error of a comparison: nobody waits for less, and more is nothing to go by.
const LEAST_ERROR: f64 = 1e-6;
const MOST_ERROR: f64 = 0.5;
/// What a policy is called that is given as a file.
const GIVEN: &str = "given";
/// Failing seeds that are named on the terminal; the files have all.
const NAMED: usize = 10;

/// Options of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Name or TOML file of the scenario
    #[arg(long, value_name = "SCENARIO", env = "TERRACRAWLER_SCENARIO")]
    pub scenario: String,
    /// How many seeds
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=MOST_RUNS))]
    pub seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1, env = "TERRACRAWLER_SEED")]
    pub seed: u64,
    /// How many robots [default: those of the scenario]
    #[arg(long, value_name = "N", env = "TERRACRAWLER_ROBOTS")]
    pub robots: Option<u32>,
    /// How far the parameters of each run differ from the scenario's [default: the scenario's]
    #[arg(long, value_enum, value_name = "PROFILE")]
    pub randomisation: Option<Randomisation>,
    /// Difficulty from 0 to 1, or the name of one of the scenario's levels
    #[arg(long, value_name = "LEVEL")]
    pub difficulty: Option<String>,
    /// Worlds that run at the same time [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Another value for a key of the scenario, like `arena.scatter.per_square_metre=0.2`
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// What the runs must come to together, like `success>=0.9`; adds to the scenario's
    #[arg(long, value_name = "METRIC>=NUMBER")]
    pub threshold: Vec<Threshold>,
    /// Who drives: `program`, as the scenario tells it; `wander`, the same robots told to wander
    /// and nothing else; `ideal`, nobody: the least time that the ways to the goals take
    #[arg(long, value_name = "DRIVER", default_value = "program", value_parser = parse_driver, conflicts_with_all = ["sweep", "monte_carlo", "adversarial"])]
    pub driver: Driver,
    /// Robots drive by a policy from the beginning on: `spread`, which comes with their program, or a file that `train`
    /// has written
    #[arg(long, value_name = "POLICY", conflicts_with_all = ["driver", "adversarial"])]
    pub policy: Option<PathBuf>,
    /// File for a table with a line for each run
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// File for everything
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Earlier file of `--json`: tells the differences between runs of one seed, with intervals
    #[arg(long, value_name = "FILE", conflicts_with_all = ["sweep", "monte_carlo", "adversarial"])]
    pub compare: Option<PathBuf>,
    /// Who drives the same seeds, `program`, `wander`, or a policy as above: runs are made in pairs, until it is known who
    /// succeeds more often, or there are as many pairs as seeds
    #[arg(long, value_name = "WHO", value_parser = Other::parse, conflicts_with_all = ["sweep", "monte_carlo", "adversarial", "compare", "csv", "threshold"])]
    pub against: Option<Other>,
    /// How often at most one is called better although neither is
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, value_parser = parse_error, requires = "against")]
    pub error: f64,
    /// Values for a key, like `parameters.chassis.running_v=0.4:0.9:6`; twice for a grid
    #[arg(long, value_name = "KEY=LEAST:MOST:POINTS", conflicts_with_all = ["monte_carlo", "adversarial"])]
    pub sweep: Vec<Axis>,
    /// So many runs, each with parameters of its own, and which of them go with failure
    #[arg(long, value_name = "N", conflicts_with = "adversarial", value_parser = clap::value_parser!(u64).range(1..=MOST_DRAWN))]
    pub monte_carlo: Option<u64>,
    /// Looks for a run that breaks something, and makes it as small as it can be
    #[arg(long, conflicts_with_all = ["csv", "json"])]
    pub adversarial: bool,
    /// Most runs of the search, and of shrinking
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u64).range(1..=MOST_RUNS), requires = "adversarial")]
    pub budget: u64,
    /// What the search is to break, like `reach` or `recovery_s` [default: anything]
    #[arg(long, value_name = "CRITERION", value_parser = parse_criterion, requires = "adversarial")]
    pub hunt: Vec<Criterion>,
    /// File for what the search has found
    #[arg(
        long,
        value_name = "FILE",
        default_value = "found.toml",
        requires = "adversarial"
    )]
    pub out: PathBuf,
}

fn parse_criterion(name: &str) -> Result<Criterion, CliError> {
    Criterion::by_name(name).ok_or_else(|| {
        let known: Vec<_> = Criterion::ALL.iter().map(|known| known.name()).collect();
        CliError::new(format!("`{name}` is none of {}", known.join(", ")))
    })
}

fn parse_driver(name: &str) -> Result<Driver, CliError> {
    Driver::by_name(name).ok_or_else(|| {
        let known = Driver::ALL.map(Driver::name);
        CliError::new(format!("`{name}` is none of {}", known.join(", ")))
    })
}

fn parse_error(text: &str) -> Result<f64, CliError> {
    let share = text.parse().ok();
    let share = share.filter(|share| (LEAST_ERROR..=MOST_ERROR).contains(share));
    share.ok_or_else(|| {
        CliError::new(format!(
            "`{text}` is no number from {LEAST_ERROR} to {MOST_ERROR}"
        ))
    })
}

/// Runs the evaluation. Success when all thresholds are met; 1 when one is not, or who drives is worse than who else does; 2 when the options
/// cannot be used, 130 when it was interrupted.
#[must_use]
pub fn run(args: &EvaluateArgs) -> ExitCode {
    evaluate(args).unwrap_or_else(|error| error.exits(2).tell())
}

fn evaluate(args: &EvaluateArgs) -> Result<ExitCode, CliError> {
    let scenario = scenario(args)?;
    let out = args.adversarial.then_some(&args.out);
    for path in args.csv.iter().chain(&args.json).chain(out) {
        can_write(path)?;
    }
    let baseline = args.compare.as_deref().map(Baseline::read).transpose()?;
    let stop = stop_on_interrupt()?;
    if let Some(other) = &args.against {
        return against::run(args, &scenario, other, &stop);
    }
    if args.adversarial {
        return hunt::run(args, scenario, &stop);
    }
    if args.monte_carlo.is_some() {
        return study::monte_carlo(args, &scenario, &stop);
    }
    if !args.sweep.is_empty() {
        return study::sweep(args, &scenario, &stop);
    }
    let jobs: Vec<Job<'_>> = (0..args.seeds)
        .map(|number| Job {
            scenario: &scenario,
            seed: args.seed.wrapping_add(number),
        })
        .collect();
    let trials = if args.driver == Driver::Ideal {
        bounds(&jobs, &stop)
    } else {
        let results = run_jobs(&jobs, args.threads, &stop);
        results.into_iter().flatten().collect()
    };
    let cut_short = trials.len() < jobs.len();
    let evaluation = Evaluation::new(&scenario, trials, &args.threshold);
    let provenance = Provenance::new(args, &scenario);
    if args.driver != Driver::Program {
        println!("driver: {}", args.driver.name());
    }
    print!("{}", evaluation.table());
    if let Some(baseline) = baseline {
        let table = baseline.table(&scenario.name, &provenance.json(), &evaluation.trials);
        print!("{table}");
    }
    // No replay shows what the program did not do, nor has it the policy.
    if args.driver == Driver::Program && args.policy.is_none() {
        explain(&repeat(args, args.randomisation, &[]), &evaluation, NAMED);
    }
    if let Some(path) = &args.csv {
        write_file(path, &(provenance.comment() + &evaluation.csv()))?;
    }
    if let Some(path) = &args.json {
        let mut value = evaluation.json();
        value["provenance"] = provenance.json();
        write_file(path, &format!("{value:#}\n"))?;
    }
    Ok(if cut_short {
        interrupted(evaluation.trials.len(), jobs.len())
    } else if evaluation.is_met() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn interrupted(done: usize, all: usize) -> ExitCode {
    eprintln!("terracrawler: interrupted after {done} of {all} runs");
    ExitCode::from(130)
}

/// What the goals of each job come to at best.
fn bounds(jobs: &[Job<'_>], stop: &AtomicBool) -> Vec<Trial> {
    let jobs = jobs.iter().take_while(|_| !stop.load(Ordering::Relaxed));
    jobs.map(|job| ideal(job.scenario, job.seed)).collect()
}

/// The scenario as the options want it.
pub(crate) fn scenario(args: &EvaluateArgs) -> Result<Scenario, CliError> {
    scenario_driven(args, args.driver, args.policy.as_deref(), "--policy")
}

/// The same for this driver, or for robots that drive by a policy, which `option` has named.
fn scenario_driven(
    args: &EvaluateArgs,
    driver: Driver,
    policy: Option<&Path>,
    option: &str,
) -> Result<Scenario, CliError> {
    let changes = Changes {
        robots: args.robots,
        randomisation: args.randomisation,
        difficulty: args.difficulty.as_deref(),
        set: &args.set,
    };
    let scenario = changes.apply(scenarios::scenario(Some(&args.scenario))?)?;
    if scenario.robots == 0 {
        return Err(CliError::new(
            "a world without robots cannot fail: there is nothing to evaluate",
        ));
    }
    let scenario = match policy {
        Some(path) => driven_by(path, scenario, option)?,
        None => scenario,
    };
    match driver {
        Driver::Program => Ok(scenario),
        Driver::Wander => Ok(wandering(scenario)),
        Driver::Ideal if scenario.goals.is_empty() => Err(CliError::new(
            "--driver ideal: the scenario has no goals, so there is no way to them",
        )),
        // Nobody looks.
        Driver::Ideal => Ok(Scenario {
            detector: None,
            ..scenario
        }),
    }
}

/// The scenario for robots that drive by the policy of this name, or in this file.
fn driven_by(path: &Path, scenario: Scenario, option: &str) -> Result<Scenario, CliError> {
    let told = |why: &dyn Display| format!("{option} {}: {why}", shown(path));
    let policy = if let Some(shipped) = path.to_str().and_then(Trained::shipped) {
        shipped
    } else {
        let blob = std::fs::read(path).or_say(|error| told(error))?;
        Trained::new(GIVEN, blob).or_say(|error| told(error))?
    };
    Ok(scenario.driven_by(policy))
}

/// Runs jobs, telling whoever waits how far it is.
fn run_jobs(jobs: &[Job<'_>], threads: Option<u16>, stop: &AtomicBool) -> Vec<Option<Trial>> {
    let all = jobs.len();
    let progress = Progress::new();
    run_all(jobs, threads_or_all(threads), stop, &|done| {
        progress.tell_runs(done, all);
    })
}

fn threads_or_all(threads: Option<u16>) -> usize {
    threads.map_or_else(
        || std::thread::available_parallelism().map_or(1, usize::from),
        usize::from,
    )
}

/// A flag that Ctrl-C sets; a second one ends the process at once.
fn stop_on_interrupt() -> Result<Arc<AtomicBool>, CliError> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .or_say(|error| format!("cannot start: {error}"))?;
    std::thread::spawn(move || {
        runtime.block_on(async {
            // Without signals Ctrl-C ends the process as ever.
            while tokio::signal::ctrl_c().await.is_ok() {
                if flag.swap(true, Ordering::Relaxed) {
                    std::process::exit(130);
                }
                eprintln!("\nfinishing the runs under way; once more ends at once");
            }
        });
    });
    Ok(stop)
}

/// The options that make one of the runs again, with this randomisation and these values too.
fn repeat(args: &EvaluateArgs, randomisation: Option<Randomisation>, values: &[String]) -> String {
    let set = [args.set.as_slice(), values].concat();
    let changes = Changes {
        robots: args.robots,
        randomisation,
        difficulty: args.difficulty.as_deref(),
        set: &set,
    };
    changes.words(&args.scenario)
}

fn shown(path: &Path) -> std::path::Display<'_> {
    path.display()
}

#[cfg(test)]
mod tests;
