//! Sweeps and Monte Carlo: which parameters matter.

use std::fmt::Write as _;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use crawler_sim::evaluate::{Cell, Evaluation, Influence, Job, drawn, grid, influences, jobs};
use crawler_sim::scenario::{Metric, Scenario};
use crawler_sim::world::Profile;
use crawler_system::cli_error::{CliError, OrSay as _};
use serde_json::json;

use super::output::{explain, write_file};
use super::provenance::Provenance;
use super::{EvaluateArgs, MOST_RUNS, NAMED, interrupted, repeat, run_jobs};
use crate::scenarios::Randomisation;

/// Columns of the table of a sweep, beside the keys.
const COLUMNS: [Metric; 6] = [
    Metric::Success,
    Metric::Reached,
    Metric::TimeToGoalS,
    Metric::PathOptimality,
    Metric::Collisions,
    Metric::CommandSuccess,
];

/// Influences that are worth a line on the terminal.
const STRONGEST: usize = 12;

/// Runs every seed at every point of a grid.
pub(super) fn sweep(
    args: &EvaluateArgs,
    scenario: &Scenario,
    stop: &AtomicBool,
) -> Result<ExitCode, CliError> {
    if args.sweep.len() > 2 {
        return Err(CliError::new("--sweep: one key or two"));
    }
    let cells = grid(scenario, &args.sweep).or_say(|error| format!("--sweep: {error}"))?;
    let seeds = args.seeds as usize;
    let runs = args.seeds.saturating_mul(cells.len() as u64);
    if runs > MOST_RUNS {
        let text = format!("--sweep: {runs} runs are more than {MOST_RUNS}");
        return Err(CliError::new(text));
    }
    let jobs: Vec<Job<'_>> = cells
        .iter()
        .flat_map(|cell| {
            (0..args.seeds).map(|number| Job {
                scenario: &cell.scenario,
                seed: args.seed.wrapping_add(number),
            })
        })
        .collect();
    let results = run_jobs(&jobs, args.threads, stop);
    let finished = results.iter().flatten().count();
    let evaluations: Vec<Evaluation> = cells
        .iter()
        .zip(results.chunks(seeds))
        .map(|(cell, trials)| {
            let trials = trials.iter().flatten().cloned().collect();
            Evaluation::new(&cell.scenario, trials, &args.threshold)
        })
        .collect();
    print!("{}", table(args, &cells, &evaluations));
    complain(args, &cells, &evaluations);
    if let Some(path) = &args.csv {
        let head = Provenance::new(args, scenario).comment();
        write_file(path, &(head + &csv(args, &cells, &evaluations)))?;
    }
    if let Some(path) = &args.json {
        let points: Vec<_> = cells
            .iter()
            .zip(&evaluations)
            .map(|(cell, evaluation)| json!({ "at": cell.at, "evaluation": evaluation.json() }))
            .collect();
        let keys: Vec<_> = args.sweep.iter().map(|axis| &axis.key).collect();
        let provenance = Provenance::new(args, scenario).json();
        let value = json!({ "keys": keys, "points": points, "provenance": provenance });
        write_file(path, &format!("{value:#}\n"))?;
    }
    Ok(if finished < jobs.len() {
        interrupted(finished, jobs.len())
    } else if evaluations.iter().all(Evaluation::is_met) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Says at which points a threshold is not met, and how to see a run that failed there.
fn complain(args: &EvaluateArgs, cells: &[Cell], evaluations: &[Evaluation]) {
    for (cell, evaluation) in cells.iter().zip(evaluations) {
        let missed = evaluation.verdicts.iter().filter(|verdict| !verdict.met);
        let missed: Vec<_> = missed
            .map(|verdict| match verdict.mean {
                Some(mean) => format!("{} ({mean:.4})", verdict.threshold),
                None => format!("{} (no run has it)", verdict.threshold),
            })
            .collect();
        if missed.is_empty() {
            continue;
        }
        let values: Vec<_> = args
            .sweep
            .iter()
            .zip(&cell.at)
            .map(|(axis, value)| format!("{}={value}", axis.key))
            .collect();
        println!("\n  {}: NOT MET {}", values.join(", "), missed.join(", "));
        explain(&repeat(args, args.randomisation, &values), evaluation, 1);
    }
}

fn table(args: &EvaluateArgs, cells: &[Cell], evaluations: &[Evaluation]) -> String {
    let mut text = String::new();
    for axis in &args.sweep {
        // Writing to a String does not fail.
        let _ = write!(
            text,
            "{:>width$} ",
            axis.key,
            width = axis.key.len().max(10)
        );
    }
    for metric in COLUMNS {
        let _ = write!(text, " {:>16}", metric.name());
    }
    text.push('\n');
    for (cell, evaluation) in cells.iter().zip(evaluations) {
        for (axis, value) in args.sweep.iter().zip(&cell.at) {
            let _ = write!(text, "{value:>width$.4} ", width = axis.key.len().max(10));
        }
        for metric in COLUMNS {
            match evaluation.mean(metric) {
                Some(mean) => {
                    let _ = write!(text, " {mean:>16.4}");
                }
                None => text.push_str("                -"),
            }
        }
        text.push('\n');
    }
    text
}

fn csv(args: &EvaluateArgs, cells: &[Cell], evaluations: &[Evaluation]) -> String {
    let keys: Vec<_> = args.sweep.iter().map(|axis| axis.key.as_str()).collect();
    let mut text = format!("{},metric,mean,low,high,runs\n", keys.join(","));
    for (cell, evaluation) in cells.iter().zip(evaluations) {
        let at: Vec<_> = cell.at.iter().map(ToString::to_string).collect();
        for line in &evaluation.lines {
            let estimate = line.estimate;
            let _ = writeln!(
                text,
                "{},{},{},{},{},{}",
                at.join(","),
                line.metric.name(),
                estimate.mean,
                estimate.low,
                estimate.high,
                estimate.count
            );
        }
    }
    text
}

/// Runs with parameters drawn for each, and tells which go with failure.
pub(super) fn monte_carlo(
    args: &EvaluateArgs,
    scenario: &Scenario,
    stop: &AtomicBool,
) -> Result<ExitCode, CliError> {
    let drawn_from = match args.randomisation {
        None if scenario.randomisation != Profile::None => None,
        None => Some(Randomisation::Wild),
        Some(Randomisation::None) => {
            return Err(CliError::new("--monte-carlo needs something to draw from"));
        }
        some => some,
    };
    let profile = drawn_from.map_or(scenario.randomisation, Randomisation::profile);
    let runs = args.monte_carlo.unwrap_or(1);
    let scenarios: Vec<Scenario> = (0..runs)
        .map(|number| drawn(scenario, profile, args.seed.wrapping_add(number)))
        .collect();
    let jobs = jobs(&scenarios, args.seed);
    let results = run_jobs(&jobs, args.threads, stop);
    let pairs: Vec<_> = scenarios
        .iter()
        .zip(&results)
        .filter_map(|(scenario, trial)| Some((scenario.parameters, trial.as_ref()?)))
        .collect();
    let influences = influences(profile, &pairs);
    let trials: Vec<_> = pairs.iter().map(|(_, trial)| (*trial).clone()).collect();
    let evaluation = Evaluation::new(scenario, trials, &args.threshold);
    print!("{}", evaluation.table());
    print!("{}", ranking(&influences, profile));
    // A world draws the same parameters from its seed.
    explain(&repeat(args, drawn_from, &[]), &evaluation, NAMED);
    if let Some(path) = &args.csv {
        let head = Provenance::new(args, scenario).comment();
        write_file(path, &(head + &evaluation.csv()))?;
    }
    if let Some(path) = &args.json {
        let list: Vec<_> = influences.iter().map(of_influence).collect();
        let value = json!({
            "profile": profile.name(),
            "influences": list,
            "evaluation": evaluation.json(),
            "provenance": Provenance::new(args, scenario).json(),
        });
        write_file(path, &format!("{value:#}\n"))?;
    }
    Ok(if pairs.len() < jobs.len() {
        interrupted(pairs.len(), jobs.len())
    } else if evaluation.is_met() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn of_influence(influence: &Influence) -> serde_json::Value {
    json!({
        "key": influence.key,
        "with_failure": influence.with_failure,
        "with_time_to_goal": influence.with_time,
    })
}

fn ranking(influences: &[Influence], profile: Profile) -> String {
    let mut text = format!(
        "\n  parameters drawn from their {profile} ranges; Spearman's rank correlation\n\n  \
         {:<32} {:>12} {:>12}\n",
        "parameter", "with failure", "with time"
    );
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
    for influence in influences.iter().take(STRONGEST) {
        let _ = writeln!(
            text,
            "  {:<32} {:>12} {:>12}",
            influence.key,
            number(influence.with_failure),
            number(influence.with_time)
        );
    }
    text
}
