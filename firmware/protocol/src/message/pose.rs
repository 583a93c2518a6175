//! Where a robot is.

use serde::{Deserialize, Serialize};

use super::wire;
use crate::RobotId;

/// A pose in the frame of the arena, and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Metres along the x axis.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub x: f32,
    /// Metres along the y axis.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub y: f32,
    /// Heading in radians, counter-clockwise from the x axis.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub theta: f32,
    /// One standard deviation of the position, in metres.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub sigma: f32,
}

/// An outside position reference for one robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PoseFix {
    /// The robot that was seen.
    pub robot: RobotId,
    /// When it was seen, in Unix milliseconds.
    pub timestamp: u64,
    /// Where it was seen.
    pub pose: Pose,
}
wire!(PoseFix);
