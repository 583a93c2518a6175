//! Faults put into robots on purpose, as robots and simulators are told of them.

use serde::de::{Deserialize, Deserializer, Error};
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::FaultSpec;
use crate::fields::{given, must, whole};
use crate::{DecodeError, EncodeError, RobotId, json};

/// Longest time for which a fault can be ordered: a day, in milliseconds.
pub const MAX_LASTING_MS: u32 = 86_400_000;

/// What is to be broken about a robot, or mended.
///
/// A robot on a bench, built and booted to take faults, obeys one that names it; a simulator obeys for
/// its robots. On the wire the fields stand beside `command`:
/// `{"command":"inject","robot":"sim-0001","fault":{"fault":"ranger-dead"},"lasting_ms":5000}`.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::exhaustive_enums)] // whoever carries faults out decides about both
pub enum FaultCommand {
    /// Put a fault into a robot.
    Inject {
        /// This one.
        robot: RobotId,
        /// What breaks.
        fault: FaultSpec,
        /// For how long, in milliseconds of the robot's world: 1 to [`MAX_LASTING_MS`]; until `heal`
        /// where there is none.
        lasting_ms: Option<u32>,
    },
    /// Mend every fault of a robot.
    Heal {
        /// This one.
        robot: RobotId,
    },
}

/// Commands of this topic, as far as a robot knows them.
#[derive(Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
enum Name {
    Inject,
    Heal,
    /// To a simulator.
    #[serde(other)]
    Other,
}

/// The name alone, whatever stands beside it.
#[derive(serde::Deserialize)]
struct Named {
    command: Name,
}

/// Every field that one of the two can have.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    command: Name,
    robot: RobotId,
    #[serde(default, deserialize_with = "given")]
    fault: Option<FaultSpec>,
    #[serde(default, deserialize_with = "given")]
    lasting_ms: Option<u32>,
}

impl FaultCommand {
    /// Writes the message as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when it does not fit `buf`; [`EncodeError::NotFinite`] when a number of
    /// the fault is not one.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        json::to_slice(self, buf)
    }

    /// Reads the message from the whole of `payload`; `None` where the command is another one, which
    /// simulators know and judge.
    ///
    /// # Errors
    /// [`DecodeError`] names what is wrong with `payload`.
    pub fn from_json(payload: &[u8]) -> Result<Option<Self>, DecodeError> {
        match json::from_slice(payload)? {
            Named {
                command: Name::Other,
            } => Ok(None),
            Named { .. } => json::from_slice(payload).map(Some),
        }
    }
}

impl<'de> Deserialize<'de> for FaultCommand {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let fields = Fields::deserialize(deserializer)?;
        let robot = fields.robot;
        match fields.command {
            Name::Inject => Ok(Self::Inject {
                robot,
                fault: must(fields.fault, "fault")?,
                lasting_ms: match fields.lasting_ms {
                    None => None,
                    Some(ms) => Some(whole(ms, MAX_LASTING_MS, &"1 ms to a day")?),
                },
            }),
            Name::Heal if fields.fault.is_some() => {
                Err(D::Error::unknown_field("fault", &["robot"]))
            }
            Name::Heal if fields.lasting_ms.is_some() => {
                Err(D::Error::unknown_field("lasting_ms", &["robot"]))
            }
            Name::Heal => Ok(Self::Heal { robot }),
            Name::Other => Err(D::Error::unknown_variant("", &["inject", "heal"])),
        }
    }
}

impl Serialize for FaultCommand {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        match self {
            Self::Inject {
                robot,
                fault,
                lasting_ms,
            } => {
                map.serialize_entry("command", "inject")?;
                map.serialize_entry("robot", robot)?;
                map.serialize_entry("fault", fault)?;
                if let Some(ms) = lasting_ms {
                    map.serialize_entry("lasting_ms", ms)?;
                }
            }
            Self::Heal { robot } => {
                map.serialize_entry("command", "heal")?;
                map.serialize_entry("robot", robot)?;
            }
        }
        map.end()
    }
}
