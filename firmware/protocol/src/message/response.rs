//! What commands came to.

use serde::{Deserialize, Serialize};

use super::wire;
use crate::{CommandName, Reason, ResponseStatus, RobotId, Source};

/// A robot's answer to a command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Response"))]
#[serde(deny_unknown_fields)]
pub struct Response<S = ResponseStatus, R = Reason> {
    /// Who answers.
    pub robot: RobotId,
    /// The number of the command.
    pub seq: u64,
    /// What the command came to.
    pub status: S,
    /// Why, where there is a why.
    pub reason: Option<R>,
    /// When, in Unix milliseconds; 0 while the robot's clock is not synchronised.
    pub timestamp: u64,
    /// Who sent the command. Missing where the robot does not know any more, and in what older ones say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<Source>,
}
wire!(Response);

/// How many robots answered a command to the swarm, by what it came to for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Outcomes {
    /// Still under way.
    pub accepted: u32,
    /// Done.
    pub completed: u32,
    /// Not acceptable.
    pub rejected: u32,
    /// Came too late.
    pub expired: u32,
    /// Overtaken by another command.
    pub stale: u32,
    /// Begun and not brought to its end.
    pub failed: u32,
    /// No answer.
    pub unanswered: u32,
}

impl Outcomes {
    /// The count of one status.
    #[must_use]
    pub const fn get(&self, status: ResponseStatus) -> u32 {
        match status {
            ResponseStatus::Accepted => self.accepted,
            ResponseStatus::Completed => self.completed,
            ResponseStatus::Rejected => self.rejected,
            ResponseStatus::Expired => self.expired,
            ResponseStatus::Stale => self.stale,
            ResponseStatus::Failed => self.failed,
        }
    }

    /// Counts one more robot.
    pub const fn add(&mut self, status: ResponseStatus) {
        let count = match status {
            ResponseStatus::Accepted => &mut self.accepted,
            ResponseStatus::Completed => &mut self.completed,
            ResponseStatus::Rejected => &mut self.rejected,
            ResponseStatus::Expired => &mut self.expired,
            ResponseStatus::Stale => &mut self.stale,
            ResponseStatus::Failed => &mut self.failed,
        };
        *count = count.saturating_add(1);
    }
}

/// What a command to the swarm came to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SwarmResponse {
    /// Who sent the command.
    pub source: Source,
    /// The number of the command.
    pub seq: u64,
    /// The command.
    pub command: CommandName,
    /// How many robots were asked.
    pub robots: u32,
    /// What they answered.
    pub outcomes: Outcomes,
    /// When this was counted, in Unix milliseconds.
    pub timestamp: u64,
}
wire!(SwarmResponse);
