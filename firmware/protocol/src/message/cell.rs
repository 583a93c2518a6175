//! Who is near: the robots of one cell.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::Says;
use crate::{DecodeError, EncodeError, RobotId, json};

/// Most neighbours in one digest.
pub const MAX_NEIGHBOURS: usize = 16;

/// Pose and twist of one robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Neighbour {
    /// The robot.
    pub id: RobotId,
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
    /// Forward speed in m/s.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub v: f32,
    /// Turning speed in rad/s, counter-clockwise.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub w: f32,
    /// What it says to its neighbours; missing while its behaviour needs nothing said.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "crate::fields::given"
    )]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Says>"))]
    pub says: Option<Says>,
}

/// The robots in one square cell of the arena, two metres wide.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CellDigest {
    /// Column: the cell spans 2·x to 2·x + 2 metres.
    pub x: i16,
    /// Row: the cell spans 2·y to 2·y + 2 metres.
    pub y: i16,
    /// When this was put together, in Unix milliseconds.
    pub timestamp: u64,
    /// How many robots are in the cell. More than `robots` has when the message was full.
    pub count: u16,
    /// As many of them as fit.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::vec::Vec<Neighbour>", length(max = 16))
    )]
    pub robots: Vec<Neighbour, MAX_NEIGHBOURS>,
}

impl CellDigest {
    /// Edge of a cell in metres.
    pub const EDGE_M: f32 = 2.0;

    /// Writes the message as JSON to the front of `buf` and returns its length.
    ///
    /// Names and numbers vary in length, so the last of `robots` are left out where all of them
    /// do not fit; `count` still tells how many there are.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when not even the frame of the message fits `buf`;
    /// [`EncodeError::NotFinite`] when a number is not one.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        #[derive(Serialize)]
        struct Fitting<'a> {
            x: i16,
            y: i16,
            timestamp: u64,
            count: u16,
            robots: &'a [Neighbour],
        }

        let mut robots = self.robots.as_slice();
        loop {
            let fitting = Fitting {
                x: self.x,
                y: self.y,
                timestamp: self.timestamp,
                count: self.count,
                robots,
            };
            match (json::to_slice(&fitting, buf), robots.split_last()) {
                (Err(EncodeError::TooLarge), Some((_, fewer))) => robots = fewer,
                (result, _) => return result,
            }
        }
    }

    /// Reads the message from the whole of `payload`.
    ///
    /// # Errors
    /// [`DecodeError`] names what is wrong with `payload`.
    pub fn from_json(payload: &[u8]) -> Result<Self, DecodeError> {
        json::from_slice(payload)
    }
}
