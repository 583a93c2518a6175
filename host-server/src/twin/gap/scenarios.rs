//! How alike the metrics of scenarios are in the simulator and in a reference reality: the same scenarios and seeds, with robots
//! whose bodies the simulator does not have.

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use crawler_experiments::scenarios::{self, Changes};
use crawler_sim::evaluate::{Job, Trial, rank_correlation, run_all};
use crawler_sim::scenario::{Metric, Scenario};
use crawler_system::cli_error::CliError;
use serde_json::{Value, json};

use super::super::args::GapArgs;
use super::table::{Table, number};
use super::{out, tell};

/// Fewest pairs of means that a rank correlation over settings is of.
const FEWEST: usize = 3;

/// A scenario at a difficulty, in both worlds.
struct Setting {
    name: String,
    simulator: Scenario,
    reference: Scenario,
}

/// A metric of a setting, in both worlds.
struct Line {
    metric: Metric,
    simulator: f64,
    reference: f64,
    runs: usize,
    /// Of runs of one seed.
    correlation: Option<f64>,
}

/// Runs the scenarios in both worlds and tells how alike they are: 0 when that could be done.
///
/// # Errors
/// One line: what cannot be done, and why.
pub(crate) fn run(args: &GapArgs) -> Result<ExitCode, CliError> {
    let file = out(args.out.as_deref())?;
    let settings = settings(args)?;
    let seeds: Vec<u64> = (0..args.seeds).map(|n| args.seed.wrapping_add(n)).collect();
    let mut found: Vec<(&Setting, Vec<Line>)> = Vec::new();
    for setting in &settings {
        let runs = |scenario| trials(scenario, &seeds, args.threads);
        let (simulator, reference) = (runs(&setting.simulator), runs(&setting.reference));
        eprintln!("{}: {} runs in each world", setting.name, seeds.len());
        found.push((setting, lines(&simulator, &reference)));
    }
    let mut tables: Vec<Table> = found
        .iter()
        .map(|(setting, lines)| of_setting(setting, lines))
        .collect();
    let across = across(&found);
    tables.push(of_all(&across, settings.len()));
    tell(
        "Reality gap of scenarios",
        &tables,
        &all(args, &found, &across),
        file,
    )?;
    Ok(ExitCode::SUCCESS)
}

fn settings(args: &GapArgs) -> Result<Vec<Setting>, CliError> {
    let levels: Vec<Option<&str>> = match &args.difficulty[..] {
        [] => vec![None],
        levels => levels.iter().map(|level| Some(level.as_str())).collect(),
    };
    let reference = match &args.reference[..] {
        [] => vec!["randomisation=wild".to_owned()],
        reference => reference.to_vec(),
    };
    let mut settings = Vec::new();
    for name in &args.scenario {
        for &difficulty in &levels {
            let of = |set: &[String]| {
                let changes = Changes {
                    robots: args.robots,
                    randomisation: None,
                    difficulty,
                    set,
                };
                let scenario = changes.apply(scenarios::scenario(Some(name))?)?;
                if scenario.robots == 0 {
                    return Err(CliError::new(format!(
                        "{name}: a world without robots shows nothing"
                    )));
                }
                Ok(scenario)
            };
            let level = difficulty.map_or_else(String::new, |level| format!(" at {level}"));
            settings.push(Setting {
                name: format!("{name}{level}"),
                simulator: of(&args.set)?,
                reference: of(&[args.set.as_slice(), &reference].concat())?,
            });
        }
    }
    Ok(settings)
}

fn trials(scenario: &Scenario, seeds: &[u64], threads: Option<u16>) -> Vec<Trial> {
    let jobs: Vec<Job<'_>> = seeds.iter().map(|&seed| Job { scenario, seed }).collect();
    let threads = threads.map_or_else(
        || std::thread::available_parallelism().map_or(1, usize::from),
        usize::from,
    );
    let never = AtomicBool::new(false);
    let trials = run_all(&jobs, threads, &never, &|_| {});
    trials.into_iter().flatten().collect()
}

/// Metrics that both worlds have, of seeds that have them in both.
fn lines(simulator: &[Trial], reference: &[Trial]) -> Vec<Line> {
    let of_metric = |metric: Metric| {
        let pairs: Vec<(f64, f64)> = simulator
            .iter()
            .zip(reference)
            .filter_map(|(a, b)| Some((a.measured.get(metric)?, b.measured.get(metric)?)))
            .collect();
        let mean = |of: fn(&(f64, f64)) -> f64| {
            pairs.iter().map(of).sum::<f64>() / pairs.len().max(1) as f64
        };
        (!pairs.is_empty()).then(|| Line {
            metric,
            simulator: mean(|pair| pair.0),
            reference: mean(|pair| pair.1),
            runs: pairs.len(),
            correlation: rank_correlation(&pairs),
        })
    };
    Metric::ALL.into_iter().filter_map(of_metric).collect()
}

/// How alike both worlds rank settings, by each metric: the metric, settings, and the rank correlation of their means.
fn across(found: &[(&Setting, Vec<Line>)]) -> Vec<(Metric, usize, Option<f64>)> {
    let of_metric = |metric: Metric| {
        let lines = found.iter().flat_map(|(_, lines)| lines);
        let pairs: Vec<(f64, f64)> = lines
            .filter(|line| line.metric == metric)
            .map(|line| (line.simulator, line.reference))
            .collect();
        let enough = pairs.len() >= FEWEST;
        let correlation = rank_correlation(&pairs).filter(|_| enough);
        (!pairs.is_empty()).then_some((metric, pairs.len(), correlation))
    };
    Metric::ALL.into_iter().filter_map(of_metric).collect()
}

fn of_setting(setting: &Setting, lines: &[Line]) -> Table {
    let mut table = Table::new(
        format!("{}: means in both worlds", setting.name),
        &[
            "metric",
            "unit",
            "simulator",
            "reference",
            "difference",
            "rank correlation",
            "runs",
        ],
    );
    table.rows = lines
        .iter()
        .map(|line| {
            vec![
                line.metric.name().to_owned(),
                line.metric.unit().to_owned(),
                number(Some(line.simulator), 4),
                number(Some(line.reference), 4),
                number(Some(line.reference - line.simulator), 4),
                number(line.correlation, 2),
                line.runs.to_string(),
            ]
        })
        .collect();
    table
}

fn of_all(across: &[(Metric, usize, Option<f64>)], settings: usize) -> Table {
    let mut table = Table::new(
        format!("Rank correlation of the means of {settings} settings"),
        &["metric", "rank correlation", "settings"],
    );
    table.rows = across
        .iter()
        .map(|&(metric, count, correlation)| {
            vec![
                metric.name().to_owned(),
                number(correlation, 2),
                count.to_string(),
            ]
        })
        .collect();
    table.notes = vec![
        "Spearman's: 1 where both worlds put all in one order, 0 where the order of one says nothing of the other's, −1 where it is reversed"
            .to_owned(),
        "rank correlation of a scenario: over runs of one seed; of all: over the means of scenarios and difficulties, three at least".to_owned(),
        "–: too few, or one world does not vary".to_owned(),
    ];
    table
}

fn all(
    args: &GapArgs,
    found: &[(&Setting, Vec<Line>)],
    across: &[(Metric, usize, Option<f64>)],
) -> Value {
    let settings: Vec<Value> = found
        .iter()
        .map(|(setting, lines)| {
            let metrics: Vec<Value> = lines
                .iter()
                .map(|line| {
                    json!({
                        "metric": line.metric.name(),
                        "unit": line.metric.unit(),
                        "simulator": line.simulator,
                        "reference": line.reference,
                        "rank_correlation": line.correlation,
                        "runs": line.runs,
                    })
                })
                .collect();
            json!({ "setting": setting.name, "metrics": metrics })
        })
        .collect();
    let across: Vec<Value> = across
        .iter()
        .map(|(metric, count, correlation)| {
            json!({ "metric": metric.name(), "settings": count, "rank_correlation": correlation })
        })
        .collect();
    json!({
        "seed": args.seed,
        "seeds": args.seeds,
        "build": env!("CARGO_PKG_VERSION"),
        "settings": settings,
        "across": across,
    })
}
