//! The doctor: looks at everything that a server needs, and says of each thing whether it is well,
//! and if not, what to do.
//!
//! It changes nothing and works beside a running server. Judgements are functions of what was found,
//! so that each can be tested with what seldom happens.

mod certificates;
mod history;
mod listeners;
mod machine;
mod records;

use std::fmt::Write as _;
use std::process::ExitCode;

use crate::config::Settings;

/// How well a thing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Grade {
    Ok,
    /// It works, and somebody should look at it.
    Warn,
    /// It does not work, or is dangerous.
    Fail,
}

impl Grade {
    const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Fail => "fail",
        }
    }
}

/// What was found about one thing.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Finding {
    grade: Grade,
    what: &'static str,
    found: String,
    /// What to do about it.
    advice: Option<String>,
}

impl Finding {
    fn ok(what: &'static str, found: impl Into<String>) -> Self {
        Self {
            grade: Grade::Ok,
            what,
            found: found.into(),
            advice: None,
        }
    }

    fn warn(what: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            grade: Grade::Warn,
            what,
            found: found.into(),
            advice: Some(advice.into()),
        }
    }

    fn fail(what: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            grade: Grade::Fail,
            what,
            found: found.into(),
            advice: Some(advice.into()),
        }
    }
}

/// Looks at everything and prints what it finds; fails when something is not well.
pub(super) async fn run(settings: &Settings) -> ExitCode {
    let mut findings = vec![Finding::ok(
        "program",
        format!("terracrawler {}", env!("CARGO_PKG_VERSION")),
    )];
    findings.extend(machine::look(settings).await);
    let running = machine::is_running(&settings.data);
    let usable = findings.iter().all(|finding| finding.grade < Grade::Fail);
    findings.extend(listeners::look(settings, running).await);
    findings.push(certificates::look(settings));
    findings.extend(history::look(settings).await);
    // A directory that is not ours to write would only be made worse.
    if usable {
        findings.extend(records::look(settings).await);
    }
    print!("{}", text(&findings));
    let worst = findings.iter().map(|finding| finding.grade).max();
    if worst == Some(Grade::Fail) {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    }
}

/// The findings, a line each, and what to do below each that is not well.
fn text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{:<4}  {:<15}  {}",
            finding.grade.word(),
            finding.what,
            finding.found
        );
        if let Some(advice) = &finding.advice {
            let _ = writeln!(text, "{:23}→ {advice}", "");
        }
    }
    let count = |grade| {
        findings
            .iter()
            .filter(|finding| finding.grade == grade)
            .count()
    };
    let _ = writeln!(
        text,
        "{} ok, {} to look at, {} failed",
        count(Grade::Ok),
        count(Grade::Warn),
        count(Grade::Fail)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finding_that_is_not_well_says_what_to_do() {
        let text = text(&[
            Finding::ok("disk", "3 GB free"),
            Finding::warn("clock", "nobody sets it", "run NTP"),
            Finding::fail("records", "damaged", "restore a backup"),
        ]);
        assert_eq!(
            text,
            "ok    disk             3 GB free\n\
             warn  clock            nobody sets it\n                       → run NTP\n\
             fail  records          damaged\n                       → restore a backup\n\
             1 ok, 1 to look at, 1 failed\n"
        );
    }
}
