//! What robots say about updates.

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{Open, Read, Unknown, UnknownWord};
use crate::json::{self, Tolerant};
use crate::{
    BuildId, DecodeError, ReasonCode, ReleaseId, RobotId, UpdateName, UpdateOutcome, UpdatePart,
    UpdateStage,
};

/// A [`crate::UpdateReport`] whose words may be later ones.
pub type UpdateReport =
    crate::UpdateReport<Open<UpdatePart>, Open<UpdateStage>, Open<UpdateOutcome>>;

/// A message of `ota/{id}`, as a server meets it.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::exhaustive_enums)] // a server decides about each
pub enum Update {
    /// A robot says this.
    Report(Read<UpdateReport>),
    /// A server said it, perhaps this one.
    Command,
    /// A kind of message of a later version.
    Unknown(UnknownWord),
}

/// Reads a message about updates, in JSON, from the whole of `payload`.
///
/// # Errors
/// [`DecodeError`] names what is wrong with what is known of it; never
/// [`DecodeError::UnknownField`].
pub fn update(payload: &[u8]) -> Result<Update, DecodeError> {
    let name: Named = json::from_slice(payload)?;
    let report = match name.update {
        Open::Unknown(word) => return Ok(Update::Unknown(word)),
        Open::Known(UpdateName::Offer | UpdateName::Confirm | UpdateName::Cancel) => {
            return Ok(Update::Command);
        }
        Open::Known(UpdateName::Have) => read::<HaveFields>(payload)?,
        Open::Known(UpdateName::Want) => read::<WantFields>(payload)?,
        Open::Known(UpdateName::Progress) => read::<ProgressFields>(payload)?,
        Open::Known(UpdateName::Outcome) => read::<OutcomeFields>(payload)?,
    };
    Ok(Update::Report(report))
}

fn read<'de, T: Deserialize<'de> + Into<UpdateReport>>(
    payload: &'de [u8],
) -> Result<Read<UpdateReport>, DecodeError> {
    let (fields, tolerant): (T, _) = json::read(payload, Tolerant::default())?;
    let message = fields.into();
    let words = match &message {
        crate::UpdateReport::Have { .. } => 0,
        crate::UpdateReport::Want { part, .. } => part.unknown(),
        crate::UpdateReport::Progress { state, .. } => state.unknown(),
        crate::UpdateReport::Outcome { outcome, .. } => outcome.unknown(),
    };
    let unknown = Unknown {
        fields: tolerant.fields,
        words,
    };
    Ok(Read { message, unknown })
}

/// What the message is, whatever stands beside it.
#[derive(Deserialize)]
struct Named {
    update: Open<UpdateName>,
}

/// The fields of [`crate::UpdateReport::Have`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HaveFields {
    #[serde(rename = "update")]
    _update: IgnoredAny,
    robot: RobotId,
    build: BuildId,
    sequence: u32,
    floor: u32,
    release: Option<ReleaseId>,
    bytes: Option<u32>,
}

impl From<HaveFields> for UpdateReport {
    fn from(fields: HaveFields) -> Self {
        Self::Have {
            robot: fields.robot,
            build: fields.build,
            sequence: fields.sequence,
            floor: fields.floor,
            release: fields.release,
            bytes: fields.bytes,
        }
    }
}

/// The fields of [`crate::UpdateReport::Want`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WantFields {
    #[serde(rename = "update")]
    _update: IgnoredAny,
    robot: RobotId,
    tag: u32,
    part: Open<UpdatePart>,
    first: u32,
    missing: u16,
}

impl From<WantFields> for UpdateReport {
    fn from(fields: WantFields) -> Self {
        Self::Want {
            robot: fields.robot,
            tag: fields.tag,
            part: fields.part,
            first: fields.first,
            missing: fields.missing,
        }
    }
}

/// The fields of [`crate::UpdateReport::Progress`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProgressFields {
    #[serde(rename = "update")]
    _update: IgnoredAny,
    robot: RobotId,
    release: ReleaseId,
    state: Open<UpdateStage>,
    reason: Option<ReasonCode>,
    bytes: u32,
    build: Option<BuildId>,
}

impl From<ProgressFields> for UpdateReport {
    fn from(fields: ProgressFields) -> Self {
        Self::Progress {
            robot: fields.robot,
            release: fields.release,
            state: fields.state,
            reason: fields.reason,
            bytes: fields.bytes,
            build: fields.build,
        }
    }
}

/// The fields of [`crate::UpdateReport::Outcome`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OutcomeFields {
    #[serde(rename = "update")]
    _update: IgnoredAny,
    robot: RobotId,
    release: ReleaseId,
    outcome: Open<UpdateOutcome>,
    reason: Option<ReasonCode>,
    build: Option<BuildId>,
    lasting: Option<bool>,
}

impl From<OutcomeFields> for UpdateReport {
    fn from(fields: OutcomeFields) -> Self {
        Self::Outcome {
            robot: fields.robot,
            release: fields.release,
            outcome: fields.outcome,
            reason: fields.reason,
            build: fields.build,
            lasting: fields.lasting,
        }
    }
}
