//! The rounds of a run: what is announced, who has answered, and what becomes of it.
//!
//! A round is over as soon as all nodes that are expected have answered, or after its deadline as soon as a quorum has. Without a quorum it
//! waits: nothing is learned from few, and nothing is lost. Answers to another announcement are late, or of another run; they change
//! nothing.
//!
//! A value without a clock or a connection: whoever has it hands in bytes and times, publishes the announcement, and keeps
//! [`checkpoint`](Coordinator::checkpoint) before the next one is published. After a crash the round that was under way begins anew by
//! the same announcement, byte for byte, so that nodes which have answered it send what they had.

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt;
use std::time::Duration;

use crate::aggregation::{Aggregation, Contribution};
use crate::message::{Announcement, Base, MOST_WEIGHTS, MessageError, Plan, Report, Update};

/// Most nodes of a run.
pub const MOST_NODES: usize = 64;
/// Longest name of a node, in bytes.
pub const LONGEST_NAME: usize = 64;

/// What a run is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Rounds in all.
    pub rounds: u32,
    /// Nodes that are expected: a round is over when so many have answered.
    pub nodes: usize,
    /// So many have to, for a round to be over.
    pub quorum: usize,
    /// How long the others are waited for.
    pub deadline: Duration,
    /// How updates become one.
    pub aggregation: Aggregation,
    /// Part of the step before that is taken again: momentum of the server (Hsu, Qi and Brown 2019, `FedAvgM`). What nodes agree
    /// on adds up, and what they do not, which is most of it, does not. 0 for none; below 1.
    pub momentum: f32,
    /// What a node does.
    pub plan: Plan,
}

/// A setting is out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SettingsError {
    /// Which one.
    pub field: &'static str,
    /// What it may be.
    pub allowed: &'static str,
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.field, self.allowed)
    }
}

impl Error for SettingsError {}

impl Settings {
    /// Whether a run can be made of them.
    ///
    /// # Errors
    /// With the first setting that is out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let check = |right: bool, field, allowed| {
            right.then_some(()).ok_or(SettingsError { field, allowed })
        };
        let deadline = (1_000..=3_600_000).contains(&self.deadline.as_millis());
        check((1..=10_000).contains(&self.rounds), "rounds", "1 to 10,000")?;
        check((1..=MOST_NODES).contains(&self.nodes), "nodes", "1 to 64")?;
        check(
            (1..=self.nodes).contains(&self.quorum),
            "quorum",
            "1 to the number of nodes",
        )?;
        check(deadline, "deadline", "1 s to an hour")?;
        check(
            (0.0..=0.99).contains(&self.momentum),
            "momentum",
            "0 to 0.99",
        )?;
        self.plan.validate().map_err(|error| match error {
            MessageError::Invalid(field) => SettingsError {
                field,
                allowed: "as documented for a plan",
            },
            _ => SettingsError {
                field: "plan",
                allowed: "as documented",
            },
        })
    }
}

/// What became of a message from a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Answer {
    /// It counts.
    Taken,
    /// The node has answered this round already; what it said first counts.
    Doubled,
    /// Of a round that is over.
    Late,
    /// Of an announcement that is none of this run's, or has another number of weights.
    OtherAnnouncement,
    /// As many nodes as are expected have answered.
    Full,
    /// The name is empty, or too long.
    Name,
    /// No message.
    Invalid(MessageError),
}

/// How many messages came to what.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// [`Answer::Taken`].
    pub taken: u64,
    /// [`Answer::Doubled`].
    pub doubled: u64,
    /// [`Answer::Late`].
    pub late: u64,
    /// All the others.
    pub refused: u64,
    /// Decisions that were learned from in rounds that are over.
    pub samples: u64,
}

/// What a round came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Round {
    /// Its number; the first one is 1.
    pub round: u32,
    /// Those who took part, by name.
    pub nodes: Vec<Part>,
    /// How long the step of the weights was, in Euclidean length.
    pub step: f64,
}

/// What a node had to say of a round.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Its name.
    pub node: String,
    /// How learning went there, by its own words.
    pub report: Report,
    /// How long its update is, in Euclidean length.
    pub step: f64,
}

/// A run.
#[derive(Debug, Clone)]
pub struct Coordinator {
    settings: Settings,
    round: u32,
    weights: Vec<f32>,
    /// The last step.
    step: Vec<f32>,
    updates: BTreeMap<String, Update>,
    counts: Counts,
    /// Of the announcement under way.
    base: Base,
    /// When it was made.
    since: Duration,
}

impl Coordinator {
    /// Begins a run from these weights, at `now`.
    ///
    /// # Errors
    /// When a setting is out of range, or weights are none, too many, or not finite.
    pub fn new(
        settings: Settings,
        weights: Vec<f32>,
        now: Duration,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        let right = (1..=MOST_WEIGHTS).contains(&weights.len())
            && weights.iter().all(|weight| weight.is_finite());
        if !right {
            return Err(SettingsError {
                field: "weights",
                allowed: "1 to 16,373 finite ones",
            });
        }
        let step = vec![0.0; weights.len()];
        Ok(Self::of(settings, 0, weights, step, Counts::default(), now))
    }

    pub(crate) fn of(
        settings: Settings,
        round: u32,
        weights: Vec<f32>,
        step: Vec<f32>,
        counts: Counts,
        now: Duration,
    ) -> Self {
        let mut coordinator = Self {
            settings,
            round,
            weights,
            step,
            updates: BTreeMap::new(),
            counts,
            base: Base::default(),
            since: now,
        };
        coordinator.base = Announcement::base(&coordinator.announcement());
        coordinator
    }

    /// What it was made of.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Rounds that are over.
    #[must_use]
    pub const fn rounds(&self) -> u32 {
        self.round
    }

    /// Whether all of them are.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.round >= self.settings.rounds
    }

    /// What has been learned so far.
    #[must_use]
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// The last step of the weights.
    pub(crate) fn last_step(&self) -> &[f32] {
        &self.step
    }

    /// How many messages came to what, in the whole run.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.counts
    }

    /// Who has answered the round under way.
    pub fn answered(&self) -> impl Iterator<Item = &str> {
        self.updates.keys().map(String::as_str)
    }

    /// What nodes are to be told now: the same bytes until the round is over.
    #[must_use]
    pub fn announcement(&self) -> Vec<u8> {
        let announcement = Announcement {
            round: self.round,
            rounds: self.settings.rounds,
            deadline_ms: u32::try_from(self.settings.deadline.as_millis()).unwrap_or(u32::MAX),
            plan: self.settings.plan,
            weights: self.weights.clone(),
        };
        announcement.to_bytes()
    }

    /// Takes what a node has sent.
    pub fn receive(&mut self, node: &str, bytes: &[u8]) -> Answer {
        let answer = self.look_at(node, bytes);
        let count = match answer {
            Answer::Taken => &mut self.counts.taken,
            Answer::Doubled => &mut self.counts.doubled,
            Answer::Late => &mut self.counts.late,
            Answer::OtherAnnouncement | Answer::Full | Answer::Name | Answer::Invalid(_) => {
                &mut self.counts.refused
            }
        };
        *count += 1;
        answer
    }

    fn look_at(&mut self, node: &str, bytes: &[u8]) -> Answer {
        if node.is_empty() || node.len() > LONGEST_NAME {
            return Answer::Name;
        }
        let update = match Update::from_bytes(bytes) {
            Ok(update) => update,
            Err(error) => return Answer::Invalid(error),
        };
        if update.round < self.round {
            return Answer::Late;
        }
        let own = update.base == self.base && update.change.len() == self.weights.len();
        if self.is_over() || update.round != self.round || !own {
            return Answer::OtherAnnouncement;
        }
        if self.updates.contains_key(node) {
            return Answer::Doubled;
        }
        if self.updates.len() >= self.settings.nodes {
            return Answer::Full;
        }
        self.updates.insert(node.to_owned(), update);
        Answer::Taken
    }

    /// How long the round may stay as it is; `None` where only an answer changes that.
    #[must_use]
    pub fn due(&self, now: Duration) -> Option<Duration> {
        if self.is_over() || self.updates.len() < self.settings.quorum {
            return None;
        }
        if self.updates.len() >= self.settings.nodes {
            return Some(Duration::ZERO);
        }
        let deadline = self.since.saturating_add(self.settings.deadline);
        Some(deadline.saturating_sub(now))
    }

    /// Ends the round if it is over at `now`, and begins the next one.
    ///
    /// A step that would take a weight beyond what a float holds is left out, and said to be as long as it is: infinite.
    pub fn close(&mut self, now: Duration) -> Option<Round> {
        if self.due(now)? > Duration::ZERO {
            return None;
        }
        let updates = std::mem::take(&mut self.updates);
        let samples = updates
            .values()
            .map(|update| u64::from(update.report.samples));
        self.counts.samples = self.counts.samples.saturating_add(samples.sum());
        let contributions: Vec<Contribution> = updates
            .values()
            .map(|update| Contribution {
                change: update.change.values().collect(),
                success: update.report.success,
            })
            .collect();
        let combined = self.settings.aggregation.combine(&contributions);
        let momentum = self.settings.momentum;
        let steps = self.step.iter().zip(&combined);
        let steps: Vec<f32> = steps.map(|(before, own)| before * momentum + own).collect();
        let moved = self.weights.iter().zip(&steps);
        let stepped: Vec<f32> = moved.map(|(weight, step)| weight + step).collect();
        let step = if stepped.iter().all(|weight| weight.is_finite()) {
            self.weights = stepped;
            self.step = steps;
            length(&self.step)
        } else {
            self.step.fill(0.0);
            f64::INFINITY
        };
        self.round += 1;
        self.since = now;
        self.base = Announcement::base(&self.announcement());
        let parts = updates.into_iter().zip(&contributions);
        let part = |((node, update), contribution): ((String, Update), &Contribution)| Part {
            node,
            report: update.report,
            step: length(&contribution.change),
        };
        Some(Round {
            round: self.round,
            nodes: parts.map(part).collect(),
            step,
        })
    }
}

fn length(change: &[f32]) -> f64 {
    let squares = change
        .iter()
        .map(|number| f64::from(*number) * f64::from(*number));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;
