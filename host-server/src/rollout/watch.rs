//! Follows a rollout to its end, or until it is paused.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use crawler_system::cli_error::CliError;
use serde_json::Value;

use super::view::{Line, Rollout};
use super::{address, show, table};
use crate::client::Client;

/// How often to ask.
const LOOK: Duration = Duration::from_secs(1);
/// A server that does not answer for so long is not waited for any longer: a rollout goes on when it comes back.
const PATIENCE: Duration = Duration::from_mins(5);
/// Exit codes, which the help of the commands names.
const PAUSED: u8 = 3;
const ABORTED: u8 = 4;

/// What the exit code is of a rollout in this state; `None` while it goes on.
fn end(state: &str) -> Option<ExitCode> {
    match state {
        "done" => Some(ExitCode::SUCCESS),
        "paused" => Some(ExitCode::from(PAUSED)),
        "aborted" => Some(ExitCode::from(ABORTED)),
        _ => None,
    }
}

/// What was printed of a rollout.
#[derive(Default)]
struct Printed {
    /// When the last line of the log happened that was printed, and how many of that time were.
    last: Option<(i64, usize)>,
    counts: String,
}

impl Printed {
    /// The lines that were not printed yet, as if they were now.
    fn take<'l>(&mut self, log: &'l [Line]) -> Vec<&'l Line> {
        let (at, known) = self.last.unwrap_or((i64::MIN, 0));
        let mut of_then = 0;
        let mut new = Vec::new();
        for line in log {
            if line.at == at {
                of_then += 1;
            }
            if line.at > at || line.at == at && of_then > known {
                new.push(line);
            }
        }
        if let Some(last) = log.last() {
            let count = log.iter().filter(|line| line.at == last.at).count();
            self.last = Some((last.at, count));
        }
        new
    }

    fn text(&mut self, rollout: &Rollout) -> String {
        let lines = self.take(&rollout.log).into_iter().map(table::happening);
        let mut lines: Vec<_> = lines.collect();
        if let Some(counts) = &rollout.counts {
            let phases = rollout.plan.phases.len();
            let states = table::states(&counts.robots);
            let counts = format!("phase {} of {phases}: {states}", rollout.phase);
            if counts != self.counts {
                lines.push(counts.clone());
                self.counts = counts;
            }
        }
        lines.push(String::new());
        lines.join("\n")
    }
}

/// Prints what becomes of a rollout, from `view` on: lines for people, or each second its JSON in a line.
///
/// # Errors
/// When the server refuses, or does not answer for five minutes.
pub(super) async fn follow(
    client: &mut Client,
    mut view: Value,
    json: bool,
) -> Result<ExitCode, CliError> {
    let mut printed = Printed::default();
    let mut heard = Instant::now();
    let mut away = false;
    loop {
        let rollout = Rollout::read(view.clone())?;
        if json {
            println!("{view}");
        } else {
            print!("{}", printed.text(&rollout));
        }
        if let Some(code) = end(&rollout.state) {
            if !json {
                println!();
                show(client, view, json).await?;
            }
            return Ok(code);
        }
        let path = address(rollout.number()?);
        view = loop {
            tokio::time::sleep(LOOK).await;
            match client.get(&path).await {
                Ok(view) => break view,
                Err(error) if error.is_passing() && heard.elapsed() < PATIENCE => {
                    if !std::mem::replace(&mut away, true) {
                        eprintln!("terracrawler: waits: {error}");
                    }
                }
                Err(error) => return Err(error.into()),
            }
        };
        heard = Instant::now();
        away = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(at: i64, what: &str) -> Line {
        Line {
            at,
            what: what.to_owned(),
            phase: None,
            reason: None,
        }
    }

    #[test]
    fn every_line_of_the_log_is_printed_once() {
        let mut printed = Printed::default();
        let mut new = |log: &[Line]| {
            let new = printed.take(log).into_iter().map(|line| line.what.clone());
            new.collect::<Vec<_>>().join(" ")
        };
        let mut log = vec![line(5, "a"), line(5, "b")];
        assert_eq!(new(&log), "a b");
        assert_eq!(new(&log), "");
        log.push(line(5, "c"));
        log.push(line(6, "d"));
        assert_eq!(new(&log), "c d");
        log.push(line(7, "e"));
        // The oldest go once there are many.
        log.drain(..3);
        assert_eq!(new(&log), "e");
        assert_eq!(new(&[]), "");
        assert_eq!(new(&log), "");
    }

    #[test]
    fn it_ends_where_nothing_happens_by_itself() {
        for (state, over) in [
            ("running", false),
            ("aborting", false),
            ("done", true),
            ("paused", true),
            ("aborted", true),
            ("of a later server", false),
        ] {
            assert_eq!(end(state).is_some(), over, "{state}");
        }
    }
}
