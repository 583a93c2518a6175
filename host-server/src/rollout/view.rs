//! Rollouts as a server tells of them. It is read openly: fields and words that only a later server knows do no harm.

use std::collections::BTreeMap;

use crawler_system::cli_error::{CliError, OrSay as _};
use serde::Deserialize;
use serde_json::Value;

/// A rollout.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Rollout {
    pub(super) id: String,
    pub(super) by: String,
    pub(super) made: i64,
    pub(super) server: String,
    pub(super) state: String,
    pub(super) reason: Option<String>,
    pub(super) phase: usize,
    pub(super) plan: Plan,
    pub(super) counts: Option<Counts>,
    #[serde(default)]
    pub(super) log: Vec<Line>,
}

/// What it is to do.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Plan {
    pub(super) releases: Vec<Release>,
    pub(super) phases: Vec<Phase>,
}

/// A release of it.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Release {
    #[serde(rename = "release")]
    pub(super) id: String,
    pub(super) board: String,
    pub(super) version: String,
}

/// A phase of it.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Phase {
    /// An object with one field.
    pub(super) select: Value,
}

/// How far it is.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Counts {
    pub(super) phases: Vec<PhaseCounts>,
    pub(super) robots: BTreeMap<String, u64>,
}

/// How far a phase is.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct PhaseCounts {
    /// A word, or an object with one field, which is that.
    pub(super) state: Value,
    pub(super) robots: BTreeMap<String, u64>,
    pub(super) failures: u64,
    pub(super) most_failures: u64,
}

/// Something that has happened.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub(super) struct Line {
    pub(super) at: i64,
    pub(super) what: String,
    #[serde(default)]
    pub(super) phase: Option<u64>,
    #[serde(default)]
    pub(super) reason: Option<String>,
}

/// A robot of a rollout.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Robot {
    #[serde(rename = "robot")]
    pub(super) id: String,
    pub(super) state: String,
    /// A word, or an object with one field.
    pub(super) reason: Value,
    pub(super) phase: Option<u64>,
    pub(super) received: u64,
    pub(super) bytes: Option<u64>,
    pub(super) since: i64,
}

fn read<T: for<'de> Deserialize<'de>>(value: Value) -> Result<T, CliError> {
    serde_json::from_value(value)
        .or_say(|error| format!("the server tells of rollouts in another way: {error}"))
}

impl Rollout {
    pub(super) fn read(value: Value) -> Result<Self, CliError> {
        read(value)
    }

    pub(super) fn read_all(value: Value) -> Result<Vec<Self>, CliError> {
        read(value)
    }

    /// Its id as a number.
    pub(super) fn number(&self) -> Result<u64, CliError> {
        let number = self.id.parse::<u64>();
        number.or_say(|_| "the server has given the rollout an id that is none".to_owned())
    }

    /// How many of its robots are in a state.
    pub(super) fn count(&self, state: &str) -> u64 {
        let counts = self.counts.as_ref();
        let count = counts.and_then(|counts| counts.robots.get(state));
        count.copied().unwrap_or(0)
    }
}

impl Robot {
    pub(super) fn read(values: Value) -> Result<Vec<Self>, CliError> {
        read(values)
    }
}
