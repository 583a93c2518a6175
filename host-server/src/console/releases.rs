//! Releases that a server is to hand out, and what they were tried on.

use std::process::ExitCode;

use crawler_records::NewRelease;
use crawler_updates::gate::GateReport;
use crawler_updates::release::{Expected, FILE_MAX, inspect, split};
use serde_json::{Value, json};

use super::Console;
use crate::config::{KeyFiles, Settings};
use crate::release::{AddArgs, Gate, read, table, told};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::clock::{now_ms, unix_ms};

/// Adds a release, and its gate where one is named, if they are genuine. Otherwise says every reason against them, as
/// `release verify` does. The gate of a release that is there already takes the place of another.
pub(super) async fn add(args: &AddArgs, settings: &Settings) -> Result<ExitCode, CliError> {
    let keys = KeyFiles::list(settings.release_key.as_ref())?;
    if keys.is_empty() {
        return Err(CliError::new(
            "no public key is named by which the release could be believed (--release-key)",
        ));
    }
    let file = read(&args.file, FILE_MAX)?;
    let expected = Expected {
        now: unix_ms() / 1_000,
        ..Expected::default()
    };
    let wrong = |fault: &dyn std::fmt::Display| told(&args.file, fault);
    let found = inspect(&file, &keys, &expected).or_say(|fault| wrong(fault))?;
    print!("{}", table::text(&args.file, &found));
    if !found.faults.is_empty() {
        return Ok(ExitCode::FAILURE);
    }
    let gate = match &args.gate {
        Some(path) => Some(Gate::read(path, &keys, &found.id.to_string())?),
        None => None,
    };
    if let Some(gate) = &gate {
        print!("{}", gate.text());
    }
    // It may say that the release did not pass: everybody is to see that, and rollouts refuse it.
    let gate = match gate {
        Some(Gate { report: Err(_), .. }) => return Ok(ExitCode::FAILURE),
        Some(Gate {
            file,
            report: Ok(report),
            ..
        }) => Some((file, report)),
        None => None,
    };
    let (envelope, image) = split(&file).or_say(|fault| wrong(fault))?;
    let console = Console::open(settings, false).await?;
    let new = NewRelease::of(envelope, image, &console.who, now_ms());
    let new = new.or_say(|fault| wrong(fault))?;
    let detail = new.for_audit();
    let done = keep(&console, new, detail, gate).await;
    console.close().await;
    let added = done.map_err(|error| error.of(args.file.display()))?;
    println!("{added}");
    Ok(ExitCode::SUCCESS)
}

/// Puts a release into the records, and its gate; the words for what was done.
async fn keep(
    console: &Console,
    new: NewRelease,
    detail: Value,
    gate: Option<(Vec<u8>, GateReport)>,
) -> Result<&'static str, CliError> {
    let releases = console.records.releases();
    let id = new.id.clone();
    let known = releases.get(&id).await?;
    let adds = gate.is_none() || known.is_none_or(|known| known.withdrawn.is_some());
    if adds {
        let result = releases.add(new).await;
        console.noted("release.add", &id, detail, result).await?;
    }
    let Some((file, report)) = gate else {
        return Ok("added");
    };
    let detail = json!({
        "passed": report.passed,
        "plan": report.plan,
        "program": report.evaluator.program,
    });
    let result = releases.set_gate(&id, file, report.passed).await;
    console.noted("release.gate", &id, detail, result).await?;
    Ok(if adds {
        "added, with its gate"
    } else {
        "was there already; has this gate now"
    })
}
