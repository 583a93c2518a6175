//! What is named in messages about updates.

use core::fmt;
use core::str::FromStr;

use heapless::String;
use serde::de::{self, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::identifier;
use crate::ids::is_id_byte;
use crate::words::words;

/// Longest name of a build, in bytes.
pub const MAX_BUILD: usize = 64;
/// Longest name of a model, in bytes.
pub const MAX_MODEL: usize = 16;
/// Longest code of a reason, in bytes.
pub const MAX_REASON_CODE: usize = 32;

/// Letters and digits of ASCII, `-`, `_`, `.` and `+`.
const fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.' | b'+')
}

identifier!(
    /// What names a program, or a model: no two builds have the same. 1 to 64 letters, digits, `-`, `_`, `.`
    /// and `+`.
    BuildId, MAX_BUILD, is_name_byte, "a build: 1 to 64 letters, digits, -, _, . and +",
    r"^[A-Za-z0-9_.+-]+$"
);
identifier!(
    /// A stable code with which a robot says why: 1 to 32 letters, digits, `-`, `_`, `.` and `+`.
    ReasonCode, MAX_REASON_CODE, is_name_byte, "a code: 1 to 32 letters, digits, -, _, . and +",
    r"^[A-Za-z0-9_.+-]+$"
);

identifier!(
    /// Which model of a robot: 1 to 16 characters of `a-z`, `0-9` and `-`, such as `detector`.
    ModelName, MAX_MODEL, is_id_byte, "a model: 1 to 16 characters of a-z, 0-9 and -", "^[a-z0-9-]+$"
);

impl BuildId {
    /// What a program goes by that was not packed as an image, and so has no build of its own: its version, of
    /// which what fits and belongs into a name is kept, and `+dev`.
    #[must_use]
    pub fn development(version: &str) -> Self {
        const SUFFIX: &str = "+dev";
        let mut text = String::new();
        let kept = version
            .chars()
            .filter(|&c| u8::try_from(c).is_ok_and(is_name_byte));
        // Each is one byte.
        for character in kept.take(MAX_BUILD - SUFFIX.len()).chain(SUFFIX.chars()) {
            let _ = text.push(character);
        }
        Self(text)
    }
}

words! {
    /// What a message about updates is.
    UpdateName {
        /// See [`UpdateCommand::Offer`](crate::UpdateCommand::Offer).
        Offer = "offer",
        /// See [`UpdateCommand::Confirm`](crate::UpdateCommand::Confirm).
        Confirm = "confirm",
        /// See [`UpdateCommand::Cancel`](crate::UpdateCommand::Cancel).
        Cancel = "cancel",
        /// See [`UpdateReport::Have`](crate::UpdateReport::Have).
        Have = "have",
        /// See [`UpdateReport::Want`](crate::UpdateReport::Want).
        Want = "want",
        /// See [`UpdateReport::Progress`](crate::UpdateReport::Progress).
        Progress = "progress",
        /// See [`UpdateReport::Outcome`](crate::UpdateReport::Outcome).
        Outcome = "outcome",
    }
}

words! {
    /// What chunks are pieces of.
    UpdatePart {
        /// The manifest with its signature, which is one chunk.
        Manifest = "manifest",
        /// The image.
        Image = "image",
        /// The patch that makes the image out of another.
        Delta = "delta",
    }
}

words! {
    /// Where a robot stands on the way to an outcome.
    UpdateStage {
        /// Not now; it is to be asked again.
        Deferred = "deferred",
        /// It makes room for the image.
        Preparing = "preparing",
        /// It receives the image.
        Receiving = "receiving",
        /// It holds the image against its hash.
        Verifying = "verifying",
        /// The image is whole, and about to be started.
        Staged = "staged",
        /// It runs the new program, and may still go back.
        Trial = "trial",
    }
}

words! {
    /// What a release came to on a robot.
    UpdateOutcome {
        /// The new program stays.
        Confirmed = "confirmed",
        /// The robot has gone back to what it ran before.
        RolledBack = "rolled_back",
        /// It does not take the release.
        Refused = "refused",
        /// It has given the release up, as it was told to.
        Withdrawn = "withdrawn",
    }
}

/// Names a release: the first 8 bytes of the SHA-256 of its manifest, without the signature; on the wire 16
/// hexadecimal digits in lower case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ReleaseId([u8; 8]);

/// A text is no [`ReleaseId`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReleaseIdError;

impl fmt::Display for ReleaseIdError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(ReleaseId::EXPECTED)
    }
}

impl core::error::Error for ReleaseIdError {}

impl ReleaseId {
    const EXPECTED: &str = "a release: 16 hexadecimal digits in lower case";

    /// The release of these bytes.
    #[must_use]
    pub const fn new(bytes: [u8; 8]) -> Self {
        Self(bytes)
    }

    /// Its bytes.
    #[must_use]
    pub const fn bytes(self) -> [u8; 8] {
        self.0
    }

    /// What its chunks carry: the first four bytes, the lowest first. Robot and server know it without a word,
    /// also after either has started anew.
    #[must_use]
    pub const fn tag(self) -> u32 {
        let [a, b, c, d, ..] = self.0;
        u32::from_le_bytes([a, b, c, d])
    }

    /// The name on the wire.
    #[must_use]
    pub fn text(self) -> String<16, u8> {
        let mut text = String::new();
        for digit in self.0.iter().flat_map(|byte| [byte >> 4, byte & 15]) {
            let digit = if digit < 10 {
                b'0' + digit
            } else {
                b'a' - 10 + digit
            };
            // There are sixteen.
            let _ = text.push(char::from(digit));
        }
        text
    }
}

impl fmt::Display for ReleaseId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text())
    }
}

impl FromStr for ReleaseId {
    type Err = ReleaseIdError;

    fn from_str(text: &str) -> Result<Self, ReleaseIdError> {
        let digits: &[u8; 16] = text.as_bytes().try_into().map_err(|_| ReleaseIdError)?;
        let (pairs, _) = digits.as_chunks::<2>();
        let mut bytes = [0; 8];
        for (byte, [high, low]) in bytes.iter_mut().zip(pairs) {
            *byte = nibble(*high)? << 4 | nibble(*low)?;
        }
        Ok(Self(bytes))
    }
}

/// One digit, which has one spelling.
const fn nibble(digit: u8) -> Result<u8, ReleaseIdError> {
    match digit {
        b'0'..=b'9' => Ok(digit - b'0'),
        b'a'..=b'f' => Ok(digit - b'a' + 10),
        _ => Err(ReleaseIdError),
    }
}

impl Serialize for ReleaseId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text())
    }
}

impl<'de> Deserialize<'de> for ReleaseId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ReleaseVisitor;

        impl Visitor<'_> for ReleaseVisitor {
            type Value = ReleaseId;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(ReleaseId::EXPECTED)
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<ReleaseId, E> {
                text.parse()
                    .map_err(|_| E::invalid_value(Unexpected::Str(text), &self))
            }
        }

        deserializer.deserialize_str(ReleaseVisitor)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for ReleaseId {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ReleaseId".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": Self::EXPECTED,
            "type": "string",
            "pattern": "^[0-9a-f]{16}$",
        })
    }
}
