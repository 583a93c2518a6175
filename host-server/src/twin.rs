//! `terracrawler twin`: identifies a robot's body from a drive, certifies it on a part that was held out,
//! shows and exports what came of it, lets it follow the robot through a recording, and measures how far both are apart.

mod args;
mod export;
mod follow;
mod gap;
mod live;
mod recording;
mod show;

use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::time::{SystemTime, UNIX_EPOCH};

use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_twin::certificate::{About, Certificate, certify, certify_on};
use crawler_twin::evidence::Evidence;
use crawler_twin::{script, table};

pub use args::{CalibrateArgs, GapArgs, Live, TwinArgs, TwinTask};
use args::{Common, ImportArgs};

use crate::config::Settings;

/// Largest table that is read, bytes.
const LARGEST_TABLE: u64 = 256 * 1024 * 1024;
/// Largest certificate that is read, bytes.
const LARGEST_CERTIFICATE: u64 = 1024 * 1024;

/// Does what the command line asks for.
#[must_use]
pub fn run(args: &TwinArgs) -> ExitCode {
    let done = match &args.task {
        TwinTask::Script => {
            print!("{}", script::scenario());
            Ok(ExitCode::SUCCESS)
        }
        TwinTask::Calibrate(args) => calibrate(args),
        TwinTask::Import(args) => import(args),
        TwinTask::Follow(args) => follow::run(args),
        TwinTask::Gap(args) => gap::scenarios(args),
        TwinTask::Show { file } => read_certificate(file).map(|certificate| {
            print!("{}", show::certificate(&certificate, now_ms()));
            ExitCode::SUCCESS
        }),
        TwinTask::Export { file } => read_certificate(file).map(|certificate| {
            print!("{}", export::scenario(&certificate));
            ExitCode::SUCCESS
        }),
    };
    done.unwrap_or_else(|error| error.exits(2).tell())
}

/// Asks a running server what is to be asked.
///
/// # Errors
/// One line: what cannot be done, and why.
pub(crate) async fn ask(args: &TwinArgs, settings: &Settings) -> Result<ExitCode, CliError> {
    match args.live() {
        Some(Live::Calibrate(args)) => live::run(args, settings).await,
        Some(Live::Gap(args)) => gap::live(args, settings).await,
        None => Err(CliError::new("nothing is asked of a server")),
    }
}

fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_millis() as u64)
}

fn told(path: &Path, error: impl std::fmt::Display) -> String {
    format!("{}: {error}", path.display())
}

/// Reads a whole file that is not larger than `most`.
fn read_file(path: &Path, most: u64) -> Result<Vec<u8>, CliError> {
    let length = fs::metadata(path).or_say(|error| told(path, error))?.len();
    if length > most {
        return Err(CliError::new(told(path, "it is too large")));
    }
    fs::read(path).or_say(|error| told(path, error))
}

fn read_certificate(path: &Path) -> Result<Certificate, CliError> {
    let text = read_file(path, LARGEST_CERTIFICATE)?;
    Certificate::read(&text).or_say(|error| told(path, error))
}

fn calibrate(args: &CalibrateArgs) -> Result<ExitCode, CliError> {
    let file = args.file.as_ref();
    let file = file.ok_or_else(|| CliError::new("there is no recording"))?;
    let drive = recording::read(file, args.robot.as_deref())?;
    let held = match &args.validate {
        Some(file) => Some(recording::read(file, Some(&drive.robot))?.evidence()),
        None => None,
    };
    let evidence = drive.evidence();
    let about = About {
        robot: drive.robot,
        build: drive.build,
        floor: args.common.floor.clone().unwrap_or_default(),
        made_ms: now_ms(),
    };
    finish(file, &evidence, held.as_ref(), about, &args.common)
}

fn import(args: &ImportArgs) -> Result<ExitCode, CliError> {
    let read = |path: &Path| {
        let text = String::from_utf8(read_file(path, LARGEST_TABLE)?)
            .or_say(|_| told(path, "it is no text in UTF-8"))?;
        table::read(&text).or_say(|error| told(path, error))
    };
    let evidence = read(&args.file)?;
    let held = args.validate.as_deref().map(read).transpose()?;
    let about = About {
        robot: args.robot.clone(),
        build: String::new(),
        floor: args.common.floor.clone().unwrap_or_default(),
        made_ms: now_ms(),
    };
    finish(&args.file, &evidence, held.as_ref(), about, &args.common)
}

/// Certifies, and says what came of it: 0 with a certificate, 1 without.
fn finish(
    path: &Path,
    evidence: &Evidence,
    held: Option<&Evidence>,
    about: About,
    common: &Common,
) -> Result<ExitCode, CliError> {
    let previous = common
        .previous
        .as_deref()
        .map(read_certificate)
        .transpose()?;
    if let Some(previous) = &previous
        && previous.about.robot != about.robot
    {
        return Err(CliError::new(format!(
            "the certificate before is of {}, and this drive of {}",
            previous.about.robot, about.robot
        )));
    }
    println!(
        "{}: {}, {} duties, {} fixes, {} voltages",
        path.display(),
        about.robot,
        evidence.duties().len(),
        evidence.fixes().len(),
        evidence.volts().len()
    );
    let made = match held {
        Some(held) => certify_on(evidence, held, about, previous.as_ref()),
        None => certify(evidence, about, previous.as_ref()),
    };
    match made {
        Ok(certificate) => {
            print!("{}", show::certificate(&certificate, now_ms()));
            if let Some(out) = &common.out {
                // Never half a certificate in the place of a whole one.
                let draft = out.with_extension("part");
                fs::write(&draft, certificate.write()).or_say(|error| told(&draft, error))?;
                fs::rename(&draft, out).or_say(|error| told(out, error))?;
                println!("written to {}", out.display());
            }
            Ok(ExitCode::SUCCESS)
        }
        Err(refused) => {
            println!("no certificate ({}): {refused}", refused.name());
            Ok(ExitCode::from(1))
        }
    }
}
