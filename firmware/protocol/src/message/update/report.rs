//! What a robot says about updates.

use serde::Serialize;

use super::{BuildId, ReasonCode, ReleaseId, UpdateOutcome, UpdatePart, UpdateStage};
use crate::{EncodeError, RobotId, json};

/// What a robot says to its server about a release. Servers read it with
/// [`open::update`](crate::open::update).
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "UpdateReport"))]
#[serde(tag = "update", rename_all = "snake_case", deny_unknown_fields)]
#[allow(clippy::exhaustive_enums)] // a server decides about each
pub enum UpdateReport<P = UpdatePart, S = UpdateStage, O = UpdateOutcome> {
    /// What the robot runs and holds: once in each session, and in answer to each offer.
    Have {
        /// Who says it.
        robot: RobotId,
        /// The program that it runs.
        build: BuildId,
        /// The sequence of that program; 0 for one that was not installed as a release.
        sequence: u32,
        /// The least sequence that it takes.
        floor: u32,
        /// The release that lies unfinished in its spare slot.
        #[serde(skip_serializing_if = "Option::is_none")]
        release: Option<ReleaseId>,
        /// Bytes of the image of that, in whole blocks.
        #[serde(skip_serializing_if = "Option::is_none")]
        bytes: Option<u32>,
    },
    /// Chunks that it asks for: those of a window that have not arrived.
    Want {
        /// Who says it.
        robot: RobotId,
        /// The transfer: [`ReleaseId::tag`].
        tag: u32,
        /// What the chunks are pieces of.
        part: P,
        /// Index of the first chunk of the window.
        first: u32,
        /// Bit *i* asks for chunk `first` + *i*.
        missing: u16,
    },
    /// Where it stands: at each change, and with each block that it has written.
    Progress {
        /// Who says it.
        robot: RobotId,
        /// The release.
        release: ReleaseId,
        /// Where it stands.
        state: S,
        /// Why, where there is a why.
        reason: Option<ReasonCode>,
        /// Bytes of the image that it has.
        bytes: u32,
        /// The program that it runs.
        #[serde(skip_serializing_if = "Option::is_none")]
        build: Option<BuildId>,
    },
    /// What the release came to.
    Outcome {
        /// Who says it.
        robot: RobotId,
        /// The release.
        release: ReleaseId,
        /// What it came to.
        outcome: O,
        /// Why, where there is a why.
        reason: Option<ReasonCode>,
        /// The program that it runs.
        #[serde(skip_serializing_if = "Option::is_none")]
        build: Option<BuildId>,
        /// Of a refusal: whether it would say the same tomorrow.
        #[serde(skip_serializing_if = "Option::is_none")]
        lasting: Option<bool>,
    },
}

impl<P, S, O> UpdateReport<P, S, O> {
    /// Who says it.
    #[must_use]
    pub const fn robot(&self) -> &RobotId {
        match self {
            Self::Have { robot, .. }
            | Self::Want { robot, .. }
            | Self::Progress { robot, .. }
            | Self::Outcome { robot, .. } => robot,
        }
    }
}

impl<P: Serialize, S: Serialize, O: Serialize> UpdateReport<P, S, O> {
    /// Writes the message as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when it does not fit `buf`.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        json::to_slice(self, buf)
    }
}
