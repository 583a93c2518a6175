//! The audit log, read only.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::process::ExitCode;

use crawler_records::{MAX_AUDIT_PAGE, Stored};
use crawler_system::cli_error::{CliError, OrSay as _};

use super::Console;
use super::args::AuditTask;
use crate::calendar::moment;
use crate::config::Settings;

pub(super) async fn run(task: AuditTask, settings: &Settings) -> Result<ExitCode, CliError> {
    let console = Console::open(settings, false).await?;
    let result = match task {
        AuditTask::List { limit, before, who } => {
            list(&console, limit, before, who.as_deref()).await
        }
        AuditTask::Verify => Ok(verify(&console).await),
        AuditTask::Export { file } => export(&console, file.as_deref()).await,
    };
    console.close().await;
    result
}

async fn list(
    console: &Console,
    limit: u32,
    mut before: Option<u64>,
    who: Option<&str>,
) -> Result<ExitCode, CliError> {
    let mut left = limit;
    let mut out = io::stdout().lock();
    while left > 0 {
        let page = left.min(MAX_AUDIT_PAGE);
        let entries = console.records.audit().page(before, page, who).await?;
        for entry in &entries {
            // Whoever reads may have seen enough.
            if writeln!(out, "{}", line(entry)).is_err() {
                return Ok(ExitCode::SUCCESS);
            }
        }
        if entries.len() < page as usize {
            break;
        }
        left -= page;
        before = entries.last().map(|entry| entry.seq);
    }
    Ok(ExitCode::SUCCESS)
}

/// One entry in one line. Names and details may come from strangers, who must not steer a terminal.
fn line(stored: &Stored) -> String {
    let entry = &stored.entry;
    let text = format!(
        "{:>8}  {}  {} from {}: {} {} {} — {}",
        stored.seq,
        moment(entry.at),
        entry.who,
        entry.from,
        entry.action,
        entry.target,
        entry.detail,
        entry.outcome
    );
    text.chars()
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect()
}

async fn verify(console: &Console) -> ExitCode {
    match console.records.audit().verify().await {
        Ok(entries) => {
            println!("The chain is whole: {entries} entries.");
            match console.records.audit().lost().await {
                Ok(0) => {}
                Ok(lost) => println!(
                    "{lost} more are missing, which could not be written when they came: entries \
                     `audit.gap` say where."
                ),
                Err(error) => {
                    eprintln!("terracrawler: how many entries are missing cannot be read: {error}");
                    return ExitCode::FAILURE;
                }
            }
            ExitCode::SUCCESS
        }
        Err(broken) => {
            eprintln!(
                "terracrawler: THE AUDIT LOG WAS CHANGED: {broken}. Keep the data directory as it is and \
                 compare with a backup; docs/operate.md says how."
            );
            ExitCode::FAILURE
        }
    }
}

async fn export(console: &Console, file: Option<&Path>) -> Result<ExitCode, CliError> {
    let entries = match file {
        None => console.records.audit().export(&mut io::stdout()).await,
        Some(path) => {
            let refused = |error: &io::Error| format!("cannot write {}: {error}", path.display());
            let file = File::options()
                .write(true)
                .create_new(true)
                .mode(0o600)
                .open(path)
                .or_say(refused)?;
            let mut file = BufWriter::new(file);
            let entries = console.records.audit().export(&mut file).await;
            file.into_inner()
                .map_err(io::IntoInnerError::into_error)
                .and_then(|file| file.sync_all())
                .or_say(refused)?;
            entries
        }
    };
    let entries = entries?;
    eprintln!("{entries} entries.");
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_records::Entry;

    #[test]
    fn no_entry_steers_the_terminal() {
        let stored = Stored {
            seq: 7,
            entry: Entry {
                at: 0,
                who: "mallory\x1b[2J".into(),
                from: "192.0.2.7".into(),
                action: "login".into(),
                target: "a\nb\u{9b}31m".into(),
                detail: serde_json::json!({}),
                outcome: "refused".into(),
            },
            hash: String::new(),
        };
        let line = line(&stored);
        assert!(!line.chars().any(char::is_control), "{line:?}");
        assert!(line.contains("192.0.2.7") && line.contains("refused"));
    }
}
