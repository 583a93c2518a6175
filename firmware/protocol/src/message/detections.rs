//! What a robot sees.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use super::wire;
use crate::RobotId;

/// Objects in one message. As many of any content fit a message.
pub const MAX_DETECTIONS: usize = 8;

/// The centre of one object in a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Detection {
    /// Name of the class.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::string::String", length(max = 10))
    )]
    pub class: String<10>,
    /// From the left edge, as a share of the width of the frame.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub x: f32,
    /// From the top edge, as a share of the height of the frame.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub y: f32,
    /// From where the robot heads to it, in radians, positive to the left.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub bearing: f32,
    /// How far the class is ahead of the next one, in steps of the detector's output.
    pub margin: u8,
}

/// What the detector found in one frame, clearest first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Detections {
    /// The robot.
    pub robot: RobotId,
    /// Rises by one with each message of this boot.
    pub seq: u64,
    /// When the frame was taken, in Unix milliseconds; 0 while the clock is not synchronised.
    pub timestamp: u64,
    /// Number of the frame.
    pub frame: u32,
    /// The objects.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::vec::Vec<Detection>", length(max = 8))
    )]
    pub objects: Vec<Detection, MAX_DETECTIONS>,
}
wire!(Detections);
