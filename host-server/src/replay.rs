//! `terracrawler replay`: a recording through the program of this build, or a seed to a moment
//! and on from there by hand; or a recorded run with something else in it.

mod prompt;
mod session;
mod what_if;

use std::fs::File;
use std::io::{BufReader, IsTerminal as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crawler_protocol::ParameterValues;
use crawler_sim::scenario::Scenario;
use crawler_sim::tools::recording::Recorded;
use crawler_sim::tools::replay::{Recording, replay};

use crawler_experiments::scenarios::{self, Changes, DETECTOR, Randomisation};
use crawler_system::cli_error::{CliError, OrSay as _};
use session::Session;

/// What `terracrawler replay` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A recording: ends with 0 when everything is as it was, with 1 when a robot does \
    otherwise; with --what-if, with 0 when there is an answer, with 1 when this build makes another run. A scenario and a seed: the run of `evaluate`, to its failure, with 1, or to its end, with \
    0; with --until or --interactive, as far as you say. 2 when it cannot be replayed."
)]
pub struct ReplayArgs {
    /// Recording to run through the program of this build
    #[arg(value_name = "FILE", conflicts_with_all = ["scenario", "restore"])]
    pub file: Option<PathBuf>,
    /// Run with another value: of a robot parameter with FILE, of a key of the scenario otherwise;
    /// may be given several times
    #[arg(long = "set", value_name = "NAME=VALUE", conflicts_with = "restore", value_parser = setting)]
    pub set: Vec<(String, String)>,
    /// Name or TOML file of a scenario to run in lockstep instead
    #[arg(long, value_name = "SCENARIO", conflicts_with = "restore")]
    pub scenario: Option<String>,
    /// Number of robots [default: those of the scenario]
    #[arg(long, value_name = "N", requires = "scenario")]
    pub robots: Option<u32>,
    /// How far the parameters of the world differ from the scenario's [default: the scenario's]
    #[arg(long, value_enum, value_name = "PROFILE", requires = "scenario")]
    pub randomisation: Option<Randomisation>,
    /// Difficulty from 0 to 1, or the name of one of the scenario's levels
    #[arg(long, value_name = "LEVEL", requires = "scenario")]
    pub difficulty: Option<String>,
    /// Seed of the world [default: 1]
    #[arg(long, value_name = "N", requires = "scenario")]
    pub seed: Option<u64>,
    /// Snapshot to begin with instead
    #[arg(long, value_name = "FILE")]
    pub restore: Option<PathBuf>,
    /// Second of the world to run to
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub until: Option<f64>,
    /// Record to this MCAP file
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    pub record: Option<PathBuf>,
    /// Make the run of FILE again, as it was and with something else in it, and tell both apart: a command of the prompt
    /// that does something to the world, like `inject 2 ranger-dead`; may be given several times
    #[arg(
        long = "what-if",
        value_name = "COMMAND",
        requires = "file",
        conflicts_with = "set"
    )]
    pub what_if: Vec<String>,
    /// Second of the run at which that is done
    #[arg(long, value_name = "S", default_value = "0", requires = "what_if", value_parser = seconds)]
    pub at: f64,
    /// Ask the same of so many other seeds, and tell by how much metrics differ in all of them
    #[arg(long, value_name = "N", default_value_t = 0, requires = "what_if", value_parser = clap::value_parser!(u32).range(..=10_000))]
    pub seeds: u32,
    /// Take commands when it is there: at a prompt, or from a pipe
    #[arg(long, conflicts_with = "file")]
    pub interactive: bool,
}

fn setting(text: &str) -> Result<(String, String), CliError> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() && !value.is_empty() => {
            Ok((name.to_owned(), value.to_owned()))
        }
        _ => Err(CliError::new("must be NAME=VALUE")),
    }
}

/// A second of a world, up to a year.
fn seconds(text: &str) -> Result<f64, CliError> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=31_536_000.0).contains(&seconds) => Ok(seconds),
        _ => Err(CliError::new("must be a number of seconds, 0 to 31536000")),
    }
}

/// Does what the command line asks for.
#[must_use]
pub fn run(args: &ReplayArgs) -> ExitCode {
    let done = match &args.file {
        Some(file) if !args.what_if.is_empty() => {
            what_if::run(file, &args.what_if, args.at, args.until, args.seeds)
        }
        Some(_) if args.until.is_some() => Err(CliError::new(
            "--until is for worlds that are run, or for --what-if",
        )),
        Some(file) => replay_file(file, &args.set),
        None => run_world(args),
    };
    done.unwrap_or_else(|error| error.exits(2).tell())
}

/// Robot parameters from the command line, through the reader that commands go through.
pub(crate) fn parameters(set: &[(String, String)]) -> Result<ParameterValues, CliError> {
    let mut object = serde_json::Map::new();
    for (name, value) in set {
        // A word that is no number and no switch is a text.
        let value = serde_json::from_str(value).unwrap_or_else(|_| value.as_str().into());
        if object.insert(name.clone(), value).is_some() {
            return Err(CliError::new(format!("`{name}` is set twice")));
        }
    }
    if object.is_empty() {
        return Ok(ParameterValues::new());
    }
    let command = serde_json::json!({ "command": "set", "parameters": object }).to_string();
    match crawler_protocol::Action::parse(command.as_bytes()) {
        Ok(crawler_protocol::Action::Set(values)) => Ok(values),
        Ok(_) => Err(CliError::new("parameters cannot be set like this")),
        Err(reason) => Err(CliError::new(format!("parameters: {}", reason.name()))),
    }
}

fn replay_file(path: &Path, set: &[(String, String)]) -> Result<ExitCode, CliError> {
    let parameters = parameters(set)?;
    let told = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let file = File::open(path).or_say(|error| told(&error))?;
    let recording = Recording::read(BufReader::new(file)).or_say(|error| told(&error))?;
    if recording.robots().next().is_none() {
        return Err(CliError::new(told(&"there is no robot in it")));
    }
    let word = |name: &str| recording.words.get(name).map_or("?", String::as_str);
    println!(
        "{}: seed {}, build {}, {} robots, {:.1} s{}",
        path.display(),
        word("seed"),
        word("build"),
        recording.robots().count(),
        recording.end_us() as f64 * 1e-6,
        if recording.cut_off { ", cut off" } else { "" }
    );
    let (mut same, mut all) = (0, 0);
    replay(&recording, &parameters, DETECTOR, |report| {
        all += 1;
        if report.is_same() {
            same += 1;
            println!(
                "{}: same ({} deeds, {} boots)",
                report.robot, report.agreed, report.boots
            );
        }
        if let Some((boot, difference)) = &report.difference {
            println!("{}: parts in boot {boot}, {difference}", report.robot);
        }
        if let Some(text) = &report.failure {
            println!("{}: its program panicked: {text}", report.robot);
        }
    })
    .or_say(|error| told(&error))?;
    println!("{same} of {all} robots do the same");
    Ok(ExitCode::from(u8::from(same != all)))
}

/// What can be asked for, for whoever has asked for nothing.
const FORMS: &str = "nothing is said of what to replay. One of
  terracrawler replay FILE                         a recording, through the program of this build
  terracrawler replay FILE --what-if COMMAND       a recorded run, with something else in it
  terracrawler replay --scenario NAME --seed N     a run of `evaluate`, to its failure
  terracrawler replay --restore FILE --until S     a snapshot, and on from there
  terracrawler replay --interactive                a world by hand, at a prompt
`terracrawler replay --help` has all options";

fn run_world(args: &ReplayArgs) -> Result<ExitCode, CliError> {
    let record = args.record.as_deref();
    let by_hand = args.interactive || args.until.is_some();
    let mut session = if let Some(path) = &args.restore {
        let snapshot = session::read_snapshot(path)?;
        Session::restored(&snapshot, record)?
    } else {
        if args.scenario.is_none() && !by_hand {
            return Err(CliError::new(FORMS));
        }
        let set = args.set.iter().map(|(key, value)| format!("{key}={value}"));
        let set: Vec<_> = set.collect();
        let changes = Changes {
            robots: args.robots,
            randomisation: args.randomisation,
            difficulty: args.difficulty.as_deref(),
            set: &set,
        };
        let name = args.scenario.as_deref();
        let scenario = changes.apply(scenarios::scenario(name)?)?;
        let seed = args.seed.unwrap_or(1);
        let words = match name {
            Some(name) => format!("replay{} --seed {seed}", changes.words(name)),
            None => format!("replay --seed {seed}"),
        };
        if !by_hand {
            return run_to_failure(&scenario, seed, record, words);
        }
        Session::new(scenario, seed, record, words)?
    };
    if let Some(until) = args.until {
        session.run_until(until)?;
    }
    println!("{}", session.summary());
    let code = if args.interactive {
        let stdin = std::io::stdin();
        let shows = stdin.is_terminal();
        prompt::run(&mut session, stdin.lock(), &mut std::io::stdout(), shows)?
    } else {
        ExitCode::SUCCESS
    };
    tell_recorded(session.finish()?.as_ref());
    Ok(code)
}

/// Runs as `evaluate` does, to the moment at which a criterion is lost, and says which.
fn run_to_failure(
    scenario: &Scenario,
    seed: u64,
    record: Option<&Path>,
    words: String,
) -> Result<ExitCode, CliError> {
    let (trial, mut session) = Session::run_to_failure(scenario, seed, record, words)?;
    println!("{}", session.summary());
    for failure in &trial.failures {
        println!("failed, {failure}");
    }
    if trial.is_success() {
        println!("succeeded");
    }
    tell_recorded(session.finish()?.as_ref());
    Ok(ExitCode::from(u8::from(!trial.is_success())))
}

fn tell_recorded(recorded: Option<&Recorded>) {
    if let Some(recorded) = recorded {
        println!(
            "recorded {} messages to {}",
            recorded.messages,
            recorded.path.display()
        );
    }
}
