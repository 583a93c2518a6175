//! Experiments and what their trials measured.

mod parts;
mod tables;
mod trials;

use std::fmt;
use std::str::FromStr;

use crate::RecordsError;

pub use parts::{
    ExperimentParts, Holder, MAX_LOST, MAX_WORKER, Part, RunningExperiment, part_size,
};
pub use tables::Experiments;
pub use trials::Trials;

/// Most experiments.
pub const MAX_EXPERIMENTS: i64 = 1_000;
/// Most of them that are trainings.
pub const MAX_TRAININGS: i64 = 100;
/// Most seeds of one experiment.
pub const MAX_SEEDS: u32 = 100_000;
/// Most trials that all experiments together may come to.
pub const MAX_TRIALS: i64 = 10_000_000;
/// Longest recipe, list of metrics and results, in bytes.
pub const MAX_EXPERIMENT_TEXT: usize = 64 * 1024;

/// How far an experiment is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ExperimentState {
    /// Nobody has started it.
    Created,
    /// It runs, or waits for its turn.
    Running,
    /// Somebody has paused it.
    Paused,
    /// Somebody has ended it before its end.
    Stopped,
    /// All trials are done.
    Completed,
    /// It cannot go on.
    Failed,
}

impl ExperimentState {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Created,
        Self::Running,
        Self::Paused,
        Self::Stopped,
        Self::Completed,
        Self::Failed,
    ];

    /// Its name in files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Created => "created",
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Stopped => "stopped",
            Self::Completed => "completed",
            Self::Failed => "failed",
        }
    }

    /// Whether it stays that way.
    #[must_use]
    pub const fn is_over(self) -> bool {
        matches!(self, Self::Stopped | Self::Completed | Self::Failed)
    }
}

impl fmt::Display for ExperimentState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ExperimentState {
    type Err = RecordsError;

    fn from_str(text: &str) -> Result<Self, RecordsError> {
        let mut all = Self::ALL.into_iter();
        let unknown = RecordsError::Invalid("an invalid state of an experiment is stored");
        all.find(|state| state.name() == text).ok_or(unknown)
    }
}

/// What an experiment is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ExperimentKind {
    /// Trials of a scenario.
    Evaluation,
    /// Rounds of learning.
    Training,
}

impl ExperimentKind {
    /// Its name in files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Evaluation => "evaluation",
            Self::Training => "training",
        }
    }
}

impl FromStr for ExperimentKind {
    type Err = RecordsError;

    fn from_str(text: &str) -> Result<Self, RecordsError> {
        let mut all = [Self::Evaluation, Self::Training].into_iter();
        let unknown = RecordsError::Invalid("an invalid kind of experiment is stored");
        all.find(|kind| kind.name() == text).ok_or(unknown)
    }
}

/// An experiment to be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewExperiment {
    /// What it is made of.
    pub kind: ExperimentKind,
    /// The server that runs it.
    pub owner: String,
    /// Its name, for people.
    pub name: String,
    /// The program that runs it.
    pub build: String,
    /// What was asked for.
    pub recipe: String,
    /// What is measured.
    pub metrics: String,
    /// How many trials it is to have, or rounds.
    pub seeds: u32,
    /// Who asked for it.
    pub by: String,
    /// When.
    pub created: i64,
    /// Whether it is started at once.
    pub start: bool,
}

/// An experiment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Experiment {
    /// Its number; later ones have greater ones.
    pub id: i64,
    /// What it is made of.
    pub kind: ExperimentKind,
    /// The server that counts its trials.
    pub owner: String,
    /// Its name, for people.
    pub name: String,
    /// What was asked for.
    pub recipe: String,
    /// What is measured.
    pub metrics: String,
    /// What the trials that are done came to; empty before the first.
    pub results: String,
    /// How many trials it is to have, or rounds.
    pub seeds: u32,
    /// Who asked for it.
    pub by: String,
    /// When.
    pub created: i64,
    /// When it was started.
    pub started: Option<i64>,
    /// When it ended.
    pub ended: Option<i64>,
    /// How far it is.
    pub state: ExperimentState,
    /// Why it is that far.
    pub reason: Option<String>,
    /// How many trials are done: the first ones. Of a training, how many rounds.
    pub done: u32,
    /// The program that runs it: another would come to other numbers. Empty where a version made it that did not say.
    pub build: String,
}

/// A trial that is done.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredTrial {
    /// Its number within the experiment, from 0.
    pub number: u32,
    /// Its seed.
    pub seed: u64,
    /// Whether everything came out as it should.
    pub success: bool,
    /// Why not.
    pub reason: Option<String>,
    /// What was measured, in the order of the experiment's metrics.
    pub measured: Vec<Option<f64>>,
}

/// Trials that are done, the next ones of their experiment, and what all so far come to. Those that a worker has
/// [stored](ExperimentParts::store) before stay as they are.
#[derive(Debug, Clone, PartialEq)]
pub struct NewTrials {
    /// Of which experiment.
    pub experiment: i64,
    /// The trials, without a gap after those that are there.
    pub trials: Vec<StoredTrial>,
    /// What all that are done come to.
    pub results: String,
    /// When the experiment was complete, if it is with these.
    pub completed: Option<i64>,
}

/// Bytes of what was measured; not-a-number stands for what was not.
fn packed(measured: &[Option<f64>]) -> Vec<u8> {
    let numbers = measured.iter().map(|value| value.unwrap_or(f64::NAN));
    numbers.flat_map(f64::to_le_bytes).collect()
}

fn unpacked(bytes: &[u8]) -> Vec<Option<f64>> {
    let (numbers, _) = bytes.as_chunks::<8>();
    let numbers = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes));
    numbers
        .map(|value| Some(value).filter(|value| value.is_finite()))
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_packed_comes_out_as_it_was(values: Vec<Option<f64>>) {
            let finite = |value: &Option<f64>| value.filter(|value| value.is_finite());
            let wanted: Vec<_> = values.iter().map(finite).collect();
            prop_assert_eq!(unpacked(&packed(&values)), wanted);
        }

        #[test]
        fn any_bytes_can_be_unpacked(bytes: Vec<u8>) {
            prop_assert_eq!(unpacked(&bytes).len(), bytes.len() / 8);
        }
    }

    #[test]
    fn kinds_go_by_their_names() {
        for kind in [ExperimentKind::Evaluation, ExperimentKind::Training] {
            assert_eq!(kind.name().parse::<ExperimentKind>().unwrap(), kind);
        }
        assert!("odd".parse::<ExperimentKind>().is_err());
    }

    #[test]
    fn states_go_by_their_names() {
        for state in ExperimentState::ALL {
            assert_eq!(state.name().parse::<ExperimentState>().unwrap(), state);
        }
        assert!("odd".parse::<ExperimentState>().is_err());
    }
}
