//! What came of a run.

use std::fmt;

use crawler_protocol::open::{StatusMessage, Unknown};
use serde_json::{Value, json};

use super::Target;

/// What a case came to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// The robot does what it must.
    Passed,
    /// It does not, and how.
    Failed(String),
    /// Could not be run, and why.
    Skipped(String),
}

impl Outcome {
    /// One word for it.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed(_) => "FAILED",
            Self::Skipped(_) => "skipped",
        }
    }

    /// Why, where there is a why.
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Passed => None,
            Self::Failed(text) | Self::Skipped(text) => Some(text),
        }
    }
}

/// One line of the report.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseReport {
    /// Name of the case.
    pub name: &'static str,
    /// What it shows.
    pub shows: &'static str,
    /// What it came to.
    pub outcome: Outcome,
    /// How long it took.
    pub seconds: f64,
}

impl fmt::Display for CaseReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name,
            shows,
            outcome,
            seconds,
        } = self;
        write!(f, "{:<7} {seconds:5.1} s  {name:<22} ", outcome.word())?;
        match outcome.reason() {
            Some(reason) => write!(f, "{reason}"),
            None => write!(f, "{shows}"),
        }
    }
}

/// The whole run.
#[derive(Debug, Clone)]
pub struct Report {
    broker: String,
    fleet: String,
    robot: String,
    status: Option<StatusMessage>,
    /// What the robot said beyond what the bench knows: it is newer.
    pub(super) unknown: Unknown,
    /// Every case that was asked for, in order.
    pub cases: Vec<CaseReport>,
}

impl Report {
    pub(super) fn new(target: &Target, status: Option<&StatusMessage>) -> Self {
        Self {
            broker: target.broker.to_string(),
            fleet: target.fleet.to_string(),
            robot: target.robot.to_string(),
            status: status.cloned(),
            unknown: Unknown::default(),
            cases: Vec::new(),
        }
    }

    fn count(&self, is: fn(&Outcome) -> bool) -> usize {
        self.cases.iter().filter(|case| is(&case.outcome)).count()
    }

    /// Cases that passed.
    pub fn passed(&self) -> usize {
        self.count(|outcome| matches!(outcome, Outcome::Passed))
    }

    /// Cases that failed.
    pub fn failed(&self) -> usize {
        self.count(|outcome| matches!(outcome, Outcome::Failed(_)))
    }

    /// Cases that could not be run.
    pub fn skipped(&self) -> usize {
        self.count(|outcome| matches!(outcome, Outcome::Skipped(_)))
    }

    /// What became of the case `name`, if it was asked for.
    pub fn outcome(&self, name: &str) -> Option<&Outcome> {
        let case = self.cases.iter().find(|case| case.name == name)?;
        Some(&case.outcome)
    }

    /// The report for programs.
    pub fn to_json(&self) -> Value {
        let status = self.status.as_ref();
        let cases: Vec<Value> = self
            .cases
            .iter()
            .map(|case| {
                json!({
                    "name": case.name,
                    "shows": case.shows,
                    "outcome": case.outcome.word().to_lowercase(),
                    "reason": case.outcome.reason(),
                    "seconds": (case.seconds * 1_000.0).round() / 1_000.0,
                })
            })
            .collect();
        json!({
            "robot": self.robot,
            "fleet": self.fleet,
            "broker": self.broker,
            "kind": status.map(|status| status.kind.name()),
            "board": status.map(|status| status.board.as_str()),
            "firmware": status.map(|status| status.firmware.as_str()),
            "unknown": { "fields": self.unknown.fields, "words": self.unknown.words },
            "passed": self.passed(),
            "failed": self.failed(),
            "skipped": self.skipped(),
            "cases": cases,
        })
    }
}

impl fmt::Display for Report {
    /// The count alone: cases are told as they end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, board, firmware) = match &self.status {
            Some(status) => (
                status.kind.name(),
                status.board.as_str(),
                status.firmware.as_str(),
            ),
            None => ("?", "?", "?"),
        };
        write!(
            f,
            "{} ({kind}, {board}, firmware {firmware}): {} passed, {} failed, {} skipped",
            self.robot,
            self.passed(),
            self.failed(),
            self.skipped()
        )
    }
}
