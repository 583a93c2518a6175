//! What a server says about updates.

use serde::Serialize;

use super::{BuildId, ReleaseId, read};
use crate::{DecodeError, EncodeError, json};

/// A patch that makes the image of a release out of another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct UpdateDelta {
    /// The build whose image it starts from.
    pub base: BuildId,
    /// Its size in bytes.
    pub bytes: u32,
}

/// What a server says to a robot about a release. Any of them may come again, and then changes nothing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "update", rename_all = "snake_case", deny_unknown_fields)]
#[allow(clippy::exhaustive_enums)] // a robot decides about each
pub enum UpdateCommand {
    /// Take this release. The robot asks for its manifest, and judges that.
    Offer {
        /// The release.
        release: ReleaseId,
        /// A shorter way to its image, for a robot that runs `base`.
        #[serde(skip_serializing_if = "Option::is_none")]
        delta: Option<UpdateDelta>,
    },
    /// The trial of this release is heard: the new program may stay.
    Confirm {
        /// The release.
        release: ReleaseId,
    },
    /// Give this release up, unless it was started already.
    Cancel {
        /// The release.
        release: ReleaseId,
    },
}

impl UpdateCommand {
    /// The release that it is about.
    #[must_use]
    pub const fn release(&self) -> ReleaseId {
        match self {
            Self::Offer { release, .. } | Self::Confirm { release } | Self::Cancel { release } => {
                *release
            }
        }
    }

    /// Writes the message as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when it does not fit `buf`.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        json::to_slice(self, buf)
    }

    /// Reads the message from the whole of `payload`; `None` where it is one of those that robots write, as
    /// one that comes back to its sender.
    ///
    /// # Errors
    /// [`DecodeError`] names what is wrong with `payload`.
    pub fn from_json(payload: &[u8]) -> Result<Option<Self>, DecodeError> {
        read::command(payload)
    }
}
