//! Releases that a server is to hand out.

use std::process::ExitCode;

use crawler_records::NewRelease;
use crawler_updates::release::{Expected, FILE_MAX, inspect, split};

use super::Console;
use crate::config::{KeyFiles, Settings};
use crate::release::{AddArgs, read, table, told};
use crawler_system::clock::{now_ms, unix_ms};

/// Adds a release, if it is genuine. Otherwise says every reason against it, as `release verify` does.
pub(super) async fn add(args: &AddArgs, settings: &Settings) -> Result<ExitCode, String> {
    let keys = KeyFiles::list(settings.release_key.as_ref())?;
    if keys.is_empty() {
        return Err(
            "no public key is named by which the release could be believed (--release-key)"
                .to_owned(),
        );
    }
    let file = read(&args.file, FILE_MAX)?;
    let expected = Expected {
        now: unix_ms() / 1_000,
        ..Expected::default()
    };
    let wrong = |fault: &dyn std::fmt::Display| told(&args.file, fault);
    let found = inspect(&file, &keys, &expected).map_err(|fault| wrong(&fault))?;
    print!("{}", table::text(&args.file, &found));
    if !found.faults.is_empty() {
        return Ok(ExitCode::FAILURE);
    }
    let (envelope, image) = split(&file).map_err(|fault| wrong(&fault))?;
    let console = Console::open(settings, false).await?;
    let new = NewRelease::of(envelope, image, &console.who, now_ms());
    let new = new.map_err(|fault| wrong(&fault))?;
    let detail = new.for_audit();
    let id = new.id.clone();
    let result = console.records.releases().add(new).await;
    let added = console.noted("release.add", &id, detail, result).await;
    console.close().await;
    added.map_err(|text| wrong(&text))?;
    println!("added");
    Ok(ExitCode::SUCCESS)
}
