//! Who a robot is, and whether it is there.

use heapless::{LinearMap, String, Vec};
use serde::{Deserialize, Serialize, Serializer};

use super::{BootCause, Capability, Kind, wire};
use crate::{BuildId, ModelName, RobotId};

/// Which start of the program this is, and why it started.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Boot"))]
#[serde(deny_unknown_fields)]
pub struct Boot<B = BootCause> {
    /// Starts so far, this one included.
    pub count: u32,
    /// Why the program started.
    pub cause: B,
    /// Where and why the program panicked before it, when that was kept: `src/file.rs:12: text`.
    /// Control characters leave as spaces, which also bounds the message.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        serialize_with = "one_line"
    )]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "Option<std::string::String>", length(max = 96))
    )]
    pub panic: Option<String<MAX_PANIC>>,
}

/// Longest text of a panic, in bytes.
pub const MAX_PANIC: usize = 96;
/// Most models that a robot tells of.
pub const MAX_MODELS: usize = 3;

/// The models that a robot has loaded, each with what names its contents.
pub type Models = LinearMap<ModelName, BuildId, MAX_MODELS>;

// The form that serde asks for.
#[allow(clippy::ref_option)]
fn one_line<S: Serializer>(
    text: &Option<String<MAX_PANIC>>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match text {
        Some(text) => super::log::one_line(text, serializer),
        None => serializer.serialize_none(),
    }
}

/// Retained description of a robot. The last will says `"online": false`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "StatusMessage"))]
#[serde(deny_unknown_fields)]
pub struct StatusMessage<K = Kind, C = Capability, B = BootCause> {
    /// The robot.
    pub robot: RobotId,
    /// Whether it is connected.
    pub online: bool,
    /// What kind of body it has.
    pub kind: K,
    /// Version of its firmware. Control characters leave as spaces, here and in the board.
    #[serde(serialize_with = "super::log::one_line")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::string::String", length(max = 32))
    )]
    pub firmware: String<32>,
    /// Its board.
    #[serde(serialize_with = "super::log::one_line")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::string::String", length(max = 16))
    )]
    pub board: String<16>,
    /// What it can do.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::vec::Vec<C>", length(max = 8))
    )]
    pub capabilities: Vec<C, 8>,
    /// Which start this is.
    pub boot: Boot<B>,
    /// Version of this contract that it speaks.
    pub protocol: u8,
    /// The program that it runs: no two programs have the same. Robots before updates do not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub build: Option<BuildId>,
    /// The models that it has loaded.
    #[serde(default, skip_serializing_if = "Models::is_empty")]
    #[cfg_attr(
        feature = "schema",
        schemars(
            with = "std::collections::BTreeMap<ModelName, BuildId>",
            extend("maxProperties" = MAX_MODELS)
        )
    )]
    pub models: Models,
}
wire!(StatusMessage);
