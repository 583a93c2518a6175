//! What is stored of a rollout beside the rows of its robots.

use std::fmt;

use crawler_protocol::RobotId;
use serde::{Deserialize, Serialize};

use super::check::{MOST_ROBOTS, PlanError};
use super::event::Now;
use super::names::{RolloutId, ServerId};
use super::plan::Plan;
use super::progress::{PhaseState, RolloutState};
use super::robot::RobotRow;

/// The version of [`Document`] and [`RobotRow`] that is written, and the only one that is read.
pub const DOCUMENT_VERSION: u16 = 1;

/// The server that a rollout belongs to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Owner {
    /// The server.
    pub server: ServerId,
    /// Rises each time the rollout goes to another server. What carries a lower one comes from a server that has
    /// lost it, and is refused.
    pub epoch: u64,
}

/// One moment, by both clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Anchor {
    /// By the rollout's own clock, which begins with it and which no clock that is set moves.
    pub elapsed_ms: u64,
    /// The Unix time of then.
    pub unix_ms: u64,
}

/// A rollout, without its robots.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Document {
    /// [`DOCUMENT_VERSION`].
    pub version: u16,
    /// Rises with every change.
    pub revision: u32,
    /// Its id.
    pub id: RolloutId,
    /// What it is to do.
    pub plan: Plan,
    /// The server that carries it out.
    pub owner: Owner,
    /// Where it stands.
    pub state: RolloutState,
    /// The phase that is served, from 0.
    pub phase: u8,
    /// Where each phase stands.
    pub phases: Vec<PhaseState>,
    /// When it began, as Unix time.
    pub began_unix_ms: u64,
    /// When this was written. After a restart the rollout's clock goes on from here by Unix time.
    pub anchor: Anchor,
}

/// Why what was stored is no rollout.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum LoadError {
    /// Another version of this program wrote it.
    Version(u16),
    /// The plan cannot be carried out.
    Plan(PlanError),
    /// The parts of the document do not fit each other.
    Document(&'static str),
    /// A row does not fit the document, or another row.
    Row(RobotId, &'static str),
    /// There are more rows than a rollout has.
    TooManyRows,
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => write!(
                f,
                "the rollout is stored in version {version}, this program reads {DOCUMENT_VERSION}"
            ),
            Self::Plan(error) => write!(f, "the stored plan is not valid: {error}"),
            Self::Document(what) => write!(f, "the stored rollout is damaged: {what}"),
            Self::Row(robot, what) => write!(f, "the stored row of {robot} is damaged: {what}"),
            Self::TooManyRows => write!(f, "the stored rollout has more than {MOST_ROBOTS} robots"),
        }
    }
}

impl std::error::Error for LoadError {}

impl Document {
    /// Whether it is one that this program can carry on.
    pub(super) fn check(&self) -> Result<(), LoadError> {
        if self.version != DOCUMENT_VERSION {
            return Err(LoadError::Version(self.version));
        }
        self.plan.check().map_err(LoadError::Plan)?;
        if self.phases.len() != self.plan.phases.len() {
            return Err(LoadError::Document("it has states of other phases"));
        }
        if usize::from(self.phase) >= self.phases.len() {
            return Err(LoadError::Document("it has no such phase"));
        }
        Ok(())
    }

    /// Whether a row is one of this rollout.
    pub(super) fn check_row(&self, row: &RobotRow) -> Result<(), LoadError> {
        let fault = |what| Err(LoadError::Row(row.robot.clone(), what));
        let release = row
            .release
            .map(|at| self.plan.releases.get(usize::from(at)));
        match (release, row.phase) {
            (Some(None), _) => return fault("it has no such release"),
            (_, Some(phase)) if usize::from(phase) >= self.phases.len() => {
                return fault("it has no such phase");
            }
            (Some(Some(release)), Some(_)) if row.received > release.bytes => {
                return fault("it has more bytes than the image");
            }
            (Some(Some(_)), Some(_)) => {}
            _ if row.state.is_over() => {}
            _ => return fault("it has no release, or no phase"),
        }
        Ok(())
    }
}

/// Where the clock stops, so that whatever is due later than now is due later: 36 million years.
const MOST_ELAPSED_MS: u64 = 1 << 60;

/// The rollout's own clock.
#[derive(Debug, Clone)]
pub(super) struct RolloutClock {
    elapsed_ms: u64,
    monotonic_ms: u64,
}

impl RolloutClock {
    /// The clock of a rollout that begins now.
    pub(super) const fn start(now: Now) -> Self {
        Self {
            elapsed_ms: 0,
            monotonic_ms: now.monotonic_ms,
        }
    }

    /// Goes on from what was stored. If the Unix time has gone back meanwhile, no time has passed.
    pub(super) const fn resume(anchor: Anchor, now: Now) -> Self {
        let away = now.unix_ms.saturating_sub(anchor.unix_ms);
        Self {
            elapsed_ms: anchor.elapsed_ms.saturating_add(away),
            monotonic_ms: now.monotonic_ms,
        }
    }

    /// It has been so late already. The anchor does not know when only rows were stored since, and the Unix time was
    /// ahead then: what they wait for would be due when it gets there once more.
    pub(super) fn has_been(&mut self, elapsed_ms: u64) {
        self.elapsed_ms = self.elapsed_ms.max(elapsed_ms);
    }

    /// Milliseconds since the rollout began.
    pub(super) const fn read(&self, now: Now) -> u64 {
        let passed = now.monotonic_ms.saturating_sub(self.monotonic_ms);
        let elapsed = self.elapsed_ms.saturating_add(passed);
        if elapsed < MOST_ELAPSED_MS {
            elapsed
        } else {
            MOST_ELAPSED_MS
        }
    }
}
