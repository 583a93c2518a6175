//! How far a rollout has come.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Why a rollout is paused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutPauseReason)]
#[serde(rename_all = "snake_case")]
pub enum PauseReason {
    /// A person wanted it so.
    Person,
    /// Too many robots of the phase have failed.
    Failures,
    /// All robots of the phase that could be reached are done, and too few are confirmed.
    Threshold,
}

/// Where a rollout stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RolloutState {
    /// It offers releases, or waits for robots, its window or the end of a soak.
    Running,
    /// It offers nothing.
    Paused(PauseReason),
    /// It was aborted; some robots still run the new program on trial.
    Aborting,
    /// It was aborted, and is over.
    Aborted,
    /// It is over.
    Done,
}

impl RolloutState {
    /// Whether nothing more happens.
    #[must_use]
    pub const fn is_over(self) -> bool {
        matches!(self, Self::Aborted | Self::Done)
    }
}

/// Where a phase stands. Times are those of the rollout's own clock, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutPhaseState)]
#[serde(rename_all = "snake_case")]
pub enum PhaseState {
    /// Those before it have not passed.
    Pending,
    /// Its robots are served.
    Active {
        /// Since when.
        since_ms: u64,
    },
    /// Its robots are done; it is watched.
    Soaking {
        /// When it began.
        since_ms: u64,
        /// Until when at least.
        until_ms: u64,
    },
    /// The next phase may begin.
    Passed {
        /// When it began.
        since_ms: u64,
        /// When it passed.
        at_ms: u64,
    },
}
