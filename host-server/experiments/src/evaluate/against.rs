//! Two who drive the same worlds, seed by seed, until it is known who succeeds more often.

use std::fmt::{self, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use crawler_sim::evaluate::{Done, Driver, Job, Trial, run_all};
use crawler_sim::scenario::{Scenario, Trained};
use crawler_system::cli_error::CliError;
use serde_json::{Value, json};

use super::output::write_file;
use super::progress::Progress;
use super::provenance::Provenance;
use super::{EvaluateArgs, interrupted, scenario_driven, threads_or_all};
use crate::sequential::{Pairs, Side, Standing, Test};

/// Who drives in the place of somebody else.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Other {
    /// The program, as the scenario tells it, or told to wander.
    Driver(Driver),
    /// A policy, by its name or file.
    Policy(PathBuf),
}

impl Other {
    /// Reads what was typed.
    pub(super) fn parse(text: &str) -> Result<Self, CliError> {
        match Driver::by_name(text) {
            Some(Driver::Ideal) => Err(CliError::new("nobody drives there, so nobody is better")),
            Some(driver) => Ok(Self::Driver(driver)),
            None if text.is_empty() => Err(CliError::new("is empty")),
            None => Ok(Self::Policy(PathBuf::from(text))),
        }
    }

    /// As the options have the one that drives by itself.
    fn first(args: &EvaluateArgs) -> Self {
        args.policy
            .clone()
            .map_or(Self::Driver(args.driver), Self::Policy)
    }

    fn scenario(&self, args: &EvaluateArgs) -> Result<Scenario, CliError> {
        match self {
            Self::Driver(driver) => scenario_driven(args, *driver, None, "--driver"),
            Self::Policy(path) => scenario_driven(args, Driver::Program, Some(path), "--against"),
        }
    }
}

impl fmt::Display for Other {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Driver(driver) => f.write_str(driver.name()),
            Self::Policy(path) => path.display().fmt(f),
        }
    }
}

/// A pair of runs with one seed.
#[derive(Debug, Clone, PartialEq)]
struct Pair {
    first: Trial,
    second: Trial,
}

/// What pairs of runs came to.
#[derive(Debug, PartialEq)]
struct Compared {
    pairs: Vec<Pair>,
    counts: Pairs,
    standing: Standing,
}

/// Runs pairs until it is known who is better, or there are as many as there may be. Success unless the one that the options say drives is
/// the worse one.
pub(super) fn run(
    args: &EvaluateArgs,
    first: &Scenario,
    other: &Other,
    stop: &AtomicBool,
) -> Result<ExitCode, CliError> {
    if args.driver == Driver::Ideal {
        return Err(CliError::new(
            "--driver ideal: nobody drives there, so nobody is better",
        ));
    }
    let second = other.scenario(args)?;
    let names = [Other::first(args), other.clone()];
    if is_same(first, &second) {
        let text = format!("--against {other}: drives already, and cannot be better than itself");
        return Err(CliError::new(text));
    }
    let test = Test::new(args.error, args.seeds)
        .ok_or_else(|| CliError::new("--error: must be more than 0 and less than 1"))?;
    let threads = threads_or_all(args.threads);
    let progress = Progress::new();
    let compared = compare(
        args.seed,
        threads,
        &test,
        [first, &second],
        stop,
        &|pairs, done| {
            let most = args.seeds;
            progress.tell(|| {
                format!(
                    "{pairs} of at most {most} pairs; {} runs of the next are over",
                    done.runs
                )
            });
        },
    );
    drop(progress);
    print!("{}", compared.table(&test, &names));
    if let Some(path) = &args.json {
        let mut value = compared.json(&test, &names, [first, &second]);
        value["provenance"] = Provenance::new(args, first).json();
        write_file(path, &format!("{value:#}\n"))?;
    }
    Ok(match compared.standing {
        Standing::Open => interrupted(2 * compared.pairs.len(), 2 * args.seeds as usize),
        Standing::Better(Side::Second) => ExitCode::FAILURE,
        Standing::Better(Side::First) | Standing::Undecided => ExitCode::SUCCESS,
    })
}

/// Whether robots do the same in both.
fn is_same(first: &Scenario, second: &Scenario) -> bool {
    let policy = |scenario: &Scenario| scenario.policy.as_ref().map(Trained::checksum);
    // Who wanders is told to in other words than the policies.
    policy(first) == policy(second) && first.to_toml().ok() == second.to_toml().ok()
}

/// Runs pairs in the order of their seeds. What is known after which of them does not depend on `threads`: what ran beyond
/// the last one is not looked at.
fn compare(
    seed: u64,
    threads: usize,
    test: &Test,
    scenarios: [&Scenario; 2],
    stop: &AtomicBool,
    watch: &(dyn Fn(u64, Done) + Sync),
) -> Compared {
    let mut compared = Compared {
        pairs: Vec::new(),
        counts: Pairs::default(),
        standing: Standing::Open,
    };
    while compared.standing == Standing::Open {
        let begun = compared.counts.count();
        let seeds = (begun..test.most())
            .take(threads)
            .map(|number| seed.wrapping_add(number));
        let jobs: Vec<Job<'_>> = seeds
            .flat_map(|seed| scenarios.map(|scenario| Job { scenario, seed }))
            .collect();
        let results = run_all(&jobs, threads, stop, &|done| watch(begun, done));
        let mut results = results.into_iter();
        while let (Some(first), Some(second)) = (results.next(), results.next()) {
            let (Some(first), Some(second)) = (first, second) else {
                // Interrupted.
                return compared;
            };
            compared.counts.add(first.is_success(), second.is_success());
            compared.pairs.push(Pair { first, second });
            compared.standing = test.judge(&compared.counts);
            if compared.standing != Standing::Open {
                break;
            }
        }
        if stop.load(Ordering::Relaxed) {
            break;
        }
    }
    compared
}

impl Compared {
    /// For people.
    fn table(&self, test: &Test, names: &[Other; 2]) -> String {
        let most = test.most();
        let Pairs {
            both,
            first,
            second,
            neither,
        } = self.counts;
        let count = self.counts.count();
        let mut text = format!(
            "{count} pairs of runs of one seed, of at most {most}\n\n  {:<8} {:<24} {:>9} {:>8}   {}\n",
            "", "driven by", "successes", "share", "interval at all times"
        );
        for (side, name) in [Side::First, Side::Second].into_iter().zip(names) {
            let successes = self.counts.successes(side);
            let share = test.share(successes, count);
            let mean = successes as f64 / count.max(1) as f64;
            // Writing to a String does not fail.
            let _ = writeln!(
                text,
                "  {:<8} {:<24} {successes:>9} {mean:>8.4}   {:.4} … {:.4}",
                called(side),
                name.to_string(),
                share.low,
                share.high
            );
        }
        let _ = writeln!(
            text,
            "\n  both succeed {both}, the first alone {first}, the second alone {second}, neither {neither}\n  \
             evidence of a difference {:.2}, of {:.2} that decide",
            self.counts.evidence().exp(),
            test.needed().exp()
        );
        let _ = match self.standing {
            Standing::Better(side) => {
                let name = &names[usize::from(side == Side::Second)];
                writeln!(text, "\nthe {} is better: {name}", called(side))
            }
            Standing::Undecided => {
                writeln!(text, "\nundecided: neither is better by enough to see it")
            }
            Standing::Open => writeln!(text, "\nbroken off: nothing is decided"),
        };
        text
    }

    /// For programs.
    fn json(&self, test: &Test, names: &[Other; 2], scenarios: [&Scenario; 2]) -> Value {
        let Pairs {
            both,
            first,
            second,
            neither,
        } = self.counts;
        let count = self.counts.count();
        let side = |side: Side, name: &Other, scenario: &Scenario| {
            let successes = self.counts.successes(side);
            let share = test.share(successes, count);
            json!({
                "driven_by": name.to_string(),
                "policy": scenario.policy.as_ref().map(Trained::checksum),
                "successes": successes,
                "share": (count > 0).then(|| successes as f64 / count as f64),
                "low": share.low,
                "high": share.high,
            })
        };
        let pairs: Vec<Value> = self.pairs.iter().map(|pair| {
            let run = |trial: &Trial| json!({
                "success": trial.is_success(),
                "history": format!("{:016x}", trial.history),
            });
            json!({ "seed": pair.first.seed, "first": run(&pair.first), "second": run(&pair.second) })
        }).collect();
        json!({
            "standing": match self.standing {
                Standing::Open => "open",
                Standing::Better(side) => called(side),
                Standing::Undecided => "undecided",
            },
            "first": side(Side::First, &names[0], scenarios[0]),
            "second": side(Side::Second, &names[1], scenarios[1]),
            "counts": {
                "pairs": count, "most": test.most(), "both": both, "first": first, "second": second, "neither": neither,
            },
            "evidence": self.counts.evidence(),
            "needed": test.needed(),
            "pairs": pairs,
        })
    }
}

const fn called(side: Side) -> &'static str {
    match side {
        Side::First => "first",
        Side::Second => "second",
    }
}

#[cfg(test)]
mod tests;
