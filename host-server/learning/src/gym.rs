//! `terracrawler gym`: worlds to learn in for another program, over standard input and output.
//!
//! They are those of `train`, with the same seeds: what [`crawler_policy::gym`] says of the protocol is all there is to
//! it. `python/` is such a program.

use std::error::Error;
use std::ffi::OsStr;
use std::io::{BufReader, BufWriter, IsTerminal as _, stdin, stdout};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::{fmt, fs, io};

use clap::Args;
use crawler_app::policy::{Policy as Blob, PolicyError, SPREAD};
use crawler_policy::gym::{ServeError, serve};
use crawler_sim::scenario::ScenarioError;

use crate::spread::Spread;
use crate::teammates::Teammates;
use crate::train::Randomisation;

/// What hello calls the task.
const NAME: &str = "spread";
/// Room for a frame of a few worlds.
const BUFFER: usize = 1 << 16;

/// Options of `gym`.
#[derive(Debug, Args)]
pub struct GymArgs {
    /// Worlds side by side
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=4_096))]
    pub worlds: u16,
    /// How far the parameters of each world differ from the nominal ones
    #[arg(long, value_enum, value_name = "PROFILE", default_value = "none")]
    pub randomisation: Randomisation,
    /// The first robot of each world learns, the others drive by a policy: `spread`, which comes with their program, or
    /// a file that `train` has written [default: all robots learn]
    #[arg(long, value_name = "NAME|FILE")]
    pub teammates: Option<PathBuf>,
    /// Threads; they change nothing but the time it takes [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

/// Why it ends other than with its input.
#[derive(Debug)]
enum GymError {
    /// A person typed it.
    Terminal,
    /// The scenario of the task.
    Scenario(ScenarioError),
    /// The file of the policy.
    File(PathBuf, io::Error),
    /// Teammates cannot drive by it.
    Policy(PathBuf, PolicyError),
    /// Whoever asked, or what was asked.
    Serve(ServeError),
}

impl fmt::Display for GymError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Terminal => f.write_str(
                "gym is for programs, which speak to it over pipes: `docs/learning.md` says how, and what there is for Python",
            ),
            Self::Scenario(error) => error.fmt(f),
            Self::File(path, error) => {
                let path = path.display();
                write!(f, "--teammates {path}: {error}; a policy that comes with the program is {NAME}")
            }
            Self::Policy(path, error) => write!(f, "--teammates {}: {error}", path.display()),
            Self::Serve(error) => error.fmt(f),
        }
    }
}

impl Error for GymError {}

/// Serves worlds until the input ends. 2 when the options, or what was asked, cannot be used; 1 when nobody reads the
/// answers.
#[must_use]
pub fn run(args: &GymArgs) -> ExitCode {
    match answer(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("terracrawler: {error}");
            ExitCode::from(match error {
                GymError::Serve(ServeError::Input(_) | ServeError::Output(_)) => 1,
                _ => 2,
            })
        }
    }
}

fn answer(args: &GymArgs) -> Result<(), GymError> {
    if stdin().is_terminal() || stdout().is_terminal() {
        return Err(GymError::Terminal);
    }
    let mut scenario = Spread::scenario().map_err(GymError::Scenario)?;
    scenario.randomisation = args.randomisation.profile();
    let scenario = Arc::new(scenario);
    let count = |number| NonZeroUsize::new(usize::from(number)).unwrap_or(NonZeroUsize::MIN);
    let worlds = count(args.worlds);
    let threads = args.threads.map_or_else(
        || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
        count,
    );
    let input = BufReader::with_capacity(BUFFER, stdin().lock());
    let output = BufWriter::with_capacity(BUFFER, stdout().lock());
    let served = if let Some(path) = &args.teammates {
        let blob = policy(path)?;
        let blob = Blob::new(&blob).map_err(|error| GymError::Policy(path.clone(), error))?;
        let make = || Teammates::new(Arc::clone(&scenario), blob);
        serve(NAME, worlds, make, threads, input, output)
    } else {
        let make = || Spread::new(Arc::clone(&scenario));
        serve(NAME, worlds, make, threads, input, output)
    };
    served.map_err(GymError::Serve)
}

/// The policy of this name, or in this file.
fn policy(path: &Path) -> Result<Vec<u8>, GymError> {
    if path.as_os_str() == OsStr::new(SPREAD.name) {
        return Ok(SPREAD.blob.to_vec());
    }
    fs::read(path).map_err(|error| GymError::File(path.to_owned(), error))
}

#[cfg(test)]
mod tests;
