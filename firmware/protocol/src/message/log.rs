//! What a robot has to tell a person.

use heapless::String;
use serde::{Deserialize, Serialize, Serializer};

use super::wire;
use crate::RobotId;
use crate::words::words;

words! {
    /// How much a log record matters.
    Level {
        /// Something does not work.
        Error = "error",
        /// Something is not as it should be.
        Warn = "warn",
        /// Something happened.
        Info = "info",
        /// Something for whoever looks for a fault.
        Debug = "debug",
    }
}

/// One line of a robot's log.
///
/// A line is one line: control characters in `event` and `text` leave as spaces. This also bounds
/// the message, because nothing else needs a six-byte escape.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "LogRecord"))]
#[serde(deny_unknown_fields)]
pub struct LogRecord<L = Level> {
    /// The robot.
    pub robot: RobotId,
    /// Rises by one with each record of this boot, so that a gap shows.
    pub seq: u64,
    /// When, in Unix milliseconds; 0 while the robot's clock is not synchronised.
    pub timestamp: u64,
    /// How much it matters.
    pub level: L,
    /// Stable name of what happened.
    #[serde(serialize_with = "one_line")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::string::String", length(max = 32))
    )]
    pub event: String<32>,
    /// The same in words.
    #[serde(serialize_with = "one_line")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::string::String", length(max = 160))
    )]
    pub text: String<160>,
}
wire!(LogRecord);

pub(super) fn one_line<const N: usize, S: Serializer>(
    text: &String<N>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut line = String::<N>::new();
    for character in text.chars() {
        // A control character takes as many bytes as a space or more, so the copy always fits.
        let _ = line.push(if character.is_control() {
            ' '
        } else {
            character
        });
    }
    serializer.serialize_str(&line)
}
