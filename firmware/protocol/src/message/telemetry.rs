//! What a robot measures, and that it lives.

pub(crate) mod cbor;
mod encoding;

use serde::{Deserialize, Serialize};

use super::{BehaviourName, Pose, RobotState, Says, wire};
use crate::{PolicyName, RobotId};

pub(crate) use encoding::Sample;
pub use encoding::{MAX_BATCH, Samples, TelemetryEncoding};

/// What the wheels are told to do.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Wheels {
    /// Left wheel, −1 to 1 of full duty.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub left: f32,
    /// Right wheel, −1 to 1 of full duty.
    #[serde(with = "crate::number")]
    #[cfg_attr(feature = "schema", schemars(with = "f32"))]
    pub right: f32,
}

/// State of the battery.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Battery {
    /// Voltage of the pack in millivolts.
    pub mv: u16,
    /// State of charge, 0 to 100 %.
    #[serde(deserialize_with = "crate::number::percent")]
    #[cfg_attr(feature = "schema", schemars(range(max = 100)))]
    pub percent: u8,
}

/// One look at a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Telemetry"))]
#[serde(deny_unknown_fields)]
pub struct Telemetry<S = RobotState, B = BehaviourName> {
    /// The robot.
    pub robot: RobotId,
    /// Rises by one with each telemetry of this boot.
    pub seq: u64,
    /// When, in Unix milliseconds; 0 while the robot's clock is not synchronised.
    pub timestamp: u64,
    /// What it is doing.
    pub state: S,
    /// The behaviour in force.
    pub behaviour: B,
    /// Where it believes to be.
    pub pose: Pose,
    /// Distance to what is ahead, in millimetres; `null` without a trustworthy reading.
    pub range_mm: Option<u16>,
    /// Temperature of the air in °C; `null` where it is not known.
    #[serde(default, with = "crate::number::optional")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f32>"))]
    pub temperature_c: Option<f32>,
    /// What the wheels are told to do.
    pub wheels: Wheels,
    /// State of the battery.
    pub battery: Battery,
    /// Strength of the received signal in dBm; `null` on a wire.
    pub rssi_dbm: Option<i8>,
    /// What it says to its neighbours; missing while its behaviour needs nothing said.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "crate::fields::given"
    )]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Says>"))]
    pub says: Option<Says>,
}
wire!(Telemetry);

/// What the comparison of a policy that does not drive with the one that does has come to, since it began or began anew.
/// Numbers stay where they are once they are as large as they get.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Shadow {
    /// The candidate: the one that does not drive.
    pub policy: PolicyName,
    /// Observations for which both have decided.
    pub decisions: u32,
    /// For how many of them both chose the same action.
    pub agreed: u32,
    /// For how many of them the shield would have taken something from the action of the candidate.
    pub vetoes: u32,
    /// The same of the policy that drives.
    pub driving_vetoes: u32,
}

/// A sign of life.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "Heartbeat"))]
#[serde(deny_unknown_fields)]
pub struct Heartbeat<S = RobotState> {
    /// The robot.
    pub robot: RobotId,
    /// Rises by one with each heartbeat of this boot.
    pub seq: u64,
    /// When, in Unix milliseconds; 0 while the robot's clock is not synchronised.
    pub timestamp: u64,
    /// Time since boot in milliseconds.
    pub uptime_ms: u64,
    /// What it is doing.
    pub state: S,
    /// How a policy that does not drive compares; missing while nobody has asked for that.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "crate::fields::given"
    )]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Shadow>"))]
    pub shadow: Option<Shadow>,
}
wire!(Heartbeat);
