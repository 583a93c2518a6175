//! `terracrawler release gate`: a release is tried with the robot program of this command line, and what comes of it is
//! signed.

mod plan;
pub(crate) mod shown;

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use crawler_experiments::scenarios::DETECTOR;
use crawler_protocol::{PROTOCOL_VERSION, ParameterValues};
use crawler_release::Kind;
use crawler_sim::evaluate::{Evaluation, Job, Line, run_all};
use crawler_sim::scenario::{Scenario, Trained};
use crawler_sim::tools::replay::{Recording, Report, replay};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::clock::unix_ms;
use crawler_updates::gate::{
    Bound, Digest, Estimate, Evaluated, Evaluator, Finding, GATE_FORMAT, GateReport, MAX_ITEMS,
    PANIC, Parted, Replayed, Threshold, rounded, sign,
};
use crawler_updates::release::{Expected, FILE_MAX, SecretKey, inspect, split};
use sha2::{Digest as _, Sha256};

use super::args::GateArgs;
use super::{exists, read, read_text, told, write_new};
use plan::{Expectation, Plan, Recorded, Task};

/// SHA-256 of the sources of the robot program that this is compiled with, as `build.rs` has found it.
const PROGRAM: &str = env!("ROBOT_PROGRAM");
/// Most bytes of a plan.
const PLAN_MAX: usize = 64 * 1024;
/// Seeds that failed that are named on the terminal.
const NAMED: usize = 5;

/// What robots that have a camera see with.
type Detector = Option<&'static [u8]>;

/// Tries a release, and writes what came of it. Success when it passed.
pub(super) fn run(args: &GateArgs) -> Result<ExitCode, CliError> {
    // Hours may go into what is to be in it.
    if args.out.exists() {
        return Err(CliError::new(exists(&args.out)));
    }
    let program: Digest = PROGRAM
        .parse()
        .map_err(|text| CliError::new(format!("the sources of the robot program: {text}")))?;
    if let Some(expected) = args.program.filter(|expected| *expected != program) {
        return Err(CliError::new(format!(
            "this command line has a robot program of other sources ({program}) than the image \
             ({expected}): build both from one tree"
        )));
    }
    let key = SecretKey::from_pem(&read_text(&args.key)?);
    let key = key.or_say(|fault| told(&args.key, &fault))?;
    let file = read(&args.file, FILE_MAX)?;
    let text = read(&args.plan, PLAN_MAX)?;
    let plan = Plan::read(&text, args.plan.parent().unwrap_or(Path::new(".")));
    let plan = plan.map_err(|error| error.of(args.plan.display()))?;
    let now = unix_ms() / 1_000;
    let expected = Expected {
        now,
        ..Expected::default()
    };
    let found = inspect(&file, &[key.public()], &expected);
    let found = found.or_say(|fault| told(&args.file, &fault))?;
    let manifest = match found.manifest {
        Some(manifest) if found.faults.is_empty() => manifest,
        _ => {
            let faults = found.faults.iter();
            let faults: Vec<_> = faults.map(|fault| fault.text.as_str()).collect();
            return Err(CliError::new(told(&args.file, &faults.join("; "))));
        }
    };
    let (_, image) = split(&file).or_say(|fault| told(&args.file, &fault))?;
    let detector = match manifest.kind {
        Kind::Program | Kind::Policy => DETECTOR,
        // Robots that see do so with the model that is tried. It is there until the end of the process.
        Kind::Model => Some(&*Box::leak(image.to_vec().into_boxed_slice())),
    };
    // Robots drive by the policy that is tried, in evaluations: what drives in a recording was recorded.
    let policy = match (manifest.kind, manifest.name) {
        (Kind::Policy, Some(name)) => {
            let policy = Trained::new(name, image.to_vec());
            Some(policy.or_say(|text| told(&args.file, &text))?)
        }
        _ => None,
    };
    let mut evaluations = Vec::new();
    for mut task in plan.tasks {
        if let Some(policy) = &policy {
            task.scenario = task.scenario.driven_by(policy.clone());
        }
        evaluations.push(evaluate(task, detector, args.threads)?);
    }
    let mut replays = Vec::new();
    for recorded in plan.recordings {
        replays.push(replayed(&recorded, detector)?);
    }
    let mut report = GateReport {
        format: GATE_FORMAT,
        release: found.id.to_string(),
        build: manifest.build.to_owned(),
        made: now,
        evaluator: Evaluator {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            protocol: PROTOCOL_VERSION,
            program,
        },
        plan: Digest(Sha256::digest(&text).into()),
        evaluations,
        replays,
        passed: false,
    };
    report.passed = report.outcome();
    let signed = sign(&report, &key)?;
    write_new(&args.out, 0o644, &[&signed])?;
    print!(
        "{}",
        shown::text(&args.out, key.public().id(), &Ok(report.clone()))
    );
    Ok(if report.passed {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Runs a scenario on its seeds.
fn evaluate(task: Task, detector: Detector, threads: Option<u16>) -> Result<Evaluated, CliError> {
    let scenario = Scenario {
        detector,
        ..task.scenario
    };
    let jobs: Vec<Job<'_>> = (0..u64::from(task.seeds))
        .map(|number| Job {
            scenario: &scenario,
            seed: task.seed + number,
        })
        .collect();
    let threads = threads.map_or_else(
        || std::thread::available_parallelism().map_or(1, usize::from),
        usize::from,
    );
    // Whoever has enough of it ends the process: nothing is written before the end.
    let never = AtomicBool::new(false);
    let trials = run_all(&jobs, threads, &never, &|_| {});
    let trials = trials.into_iter().flatten().collect();
    let evaluation = Evaluation::new(&scenario, trials, &task.thresholds);
    print!("{}", evaluation.table());
    for trial in evaluation.failed().take(NAMED) {
        for failure in &trial.failures {
            println!("  seed {}: {failure}", trial.seed);
        }
    }
    println!();
    let text = scenario.to_toml()?;
    let failures = evaluation.failed().count() as u32;
    Ok(Evaluated {
        scenario: scenario.name.clone(),
        sha256: Digest(Sha256::digest(text.as_bytes()).into()),
        robots: scenario.robots,
        seed: task.seed,
        seeds: task.seeds,
        successes: task.seeds - failures,
        thresholds: evaluation
            .verdicts
            .iter()
            .map(|verdict| {
                let threshold = verdict.threshold;
                let line = evaluation.lines.iter();
                let line = line.clone().find(|line| line.metric == threshold.metric);
                let bound = rounded(threshold.value);
                Threshold {
                    metric: threshold.metric.name().to_owned(),
                    bound: if threshold.at_least {
                        Bound::AtLeast(bound)
                    } else {
                        Bound::AtMost(bound)
                    },
                    measured: line.map(estimate),
                }
            })
            .collect(),
    })
}

fn estimate(line: &Line) -> Estimate {
    let estimate = line.estimate;
    let mean = rounded(estimate.mean);
    Estimate {
        mean,
        // An end at the mean is not on its other side, however they were rounded.
        low: rounded(estimate.low).min(mean),
        high: rounded(estimate.high).max(mean),
        runs: estimate.count as u32,
    }
}

/// Runs a recording through the program.
fn replayed(recorded: &Recorded, detector: Detector) -> Result<Replayed, CliError> {
    let path = &recorded.path;
    let wrong = |error: &dyn std::fmt::Display| told(path, error);
    let sha256 = file_digest(path).or_say(|error| wrong(error))?;
    let file = File::open(path).or_say(|error| wrong(error))?;
    let recording = Recording::read(BufReader::new(file)).or_say(|error| wrong(error))?;
    let reports = replay(&recording, &ParameterValues::new(), detector, |_| {});
    let reports = reports.or_say(|error| wrong(error))?;
    for report in &reports {
        if let Some((boot, difference)) = &report.difference {
            println!("{}: parts in boot {boot}, {difference}", report.robot);
        }
        if let Some(text) = &report.failure {
            println!("{}: its program panicked: {text}", report.robot);
        }
    }
    let parted: Vec<_> = reports.iter().filter_map(parted).collect();
    let same = (reports.len() - parted.len()) as u32;
    let (differences, more) = compare(&parted, &recorded.expected);
    Ok(Replayed {
        recording: recorded.name.clone(),
        sha256,
        robots: reports.len() as u32,
        same,
        differences,
        more,
    })
}

/// Which robot parts from its recording, where, and when.
type Difference<'a> = (&'a str, &'static str, u64);

fn parted(report: &Report) -> Option<Difference<'_>> {
    let robot = report.robot.as_str();
    match (&report.failure, &report.difference) {
        (None, None) => None,
        (None, Some((_, difference))) => Some((robot, difference.output, difference.at_us)),
        (Some(_), _) => Some((robot, PANIC, 0)),
    }
}

/// What parts, held against what is expected to, and how many robots there was no room to name. What is expected has
/// room.
fn compare(parted: &[Difference<'_>], expected: &[Expectation]) -> (Vec<Parted>, u32) {
    let mut found = BTreeSet::new();
    let mut unexpected = Vec::new();
    for &(robot, output, at_us) in parted {
        let is_it =
            |one: &Expectation| (&*one.robot, &*one.output, one.at_us) == (robot, output, at_us);
        match expected.iter().position(is_it) {
            Some(number) => {
                found.insert(number);
            }
            None => unexpected.push(Parted {
                robot: robot.to_owned(),
                output: output.to_owned(),
                at_us,
                finding: Finding::Unexpected,
                why: None,
            }),
        }
    }
    let expected = expected.iter().enumerate().map(|(number, one)| Parted {
        robot: one.robot.clone(),
        output: one.output.clone(),
        at_us: one.at_us,
        finding: if found.contains(&number) {
            Finding::Expected
        } else {
            Finding::Missing
        },
        why: Some(one.why.clone()),
    });
    let mut all: Vec<Parted> = expected.collect();
    let room = MAX_ITEMS.saturating_sub(all.len());
    let more = unexpected.len().saturating_sub(room);
    unexpected.truncate(room);
    all.append(&mut unexpected);
    (all, more as u32)
}

fn file_digest(path: &Path) -> std::io::Result<Digest> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut piece = vec![0; 64 * 1024];
    loop {
        match file.read(&mut piece)? {
            0 => return Ok(Digest(hash.finalize().into())),
            length => hash.update(&piece[..length]),
        }
    }
}

#[cfg(test)]
mod tests;
