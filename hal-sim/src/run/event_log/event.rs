//! What passes through the devices of a robot.

use std::net::IpAddr;

use crawler_hal::NetError;
use crawler_protocol::{BehaviourName, RobotState};
use serde::{Deserialize, Serialize};

use crate::run::journal::Payload;

/// What a robot's devices said and did, and when: microseconds since the beginning of the world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event(pub u64, pub What);

/// A wheel's half of the motor driver, or the lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// Duty of the left enable input.
    LeftDuty,
    /// Of the right one.
    RightDuty,
    /// First direction pin of the left half.
    LeftIn1,
    /// Second one.
    LeftIn2,
    /// First direction pin of the right half.
    RightIn1,
    /// Second one.
    RightIn2,
    /// The lamp.
    Lamp,
}

/// What happened at a device. The first half is what the program hears, the second what it does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[non_exhaustive]
pub enum What {
    /// Bytes from the ranger's line; `null` when it is broken.
    Heard(Option<Payload>),
    /// A wait for the echo pin was over.
    Echo,
    /// The echo pin was looked at.
    EchoLevel(bool),
    /// The battery's divider, millivolts; `null` when it cannot be read.
    Battery(Option<u16>),
    /// A picture, or a still, as the camera gave it.
    Picture(Result<Payload, Lens>),
    /// The flash refused operation number so and so of this boot.
    FlashRefused(u64, Flash),
    /// An access point was joined, or not.
    Joined(Option<Net>),
    /// A connection was opened, or not.
    Connected(Option<Net>),
    /// Bytes from the network; none at the end of the connection, `null` when it broke.
    Received(Option<Payload>),
    /// The radio's word on its access point.
    Link(Option<(IpAddr, Option<i8>)>),
    /// A command that came past the network.
    Told(Payload),
    /// Unix time in milliseconds that came past the network.
    Time(u64),
    /// Its clock was put off by so many milliseconds, by a fault.
    ClockStep(i64),

    /// The program asked something of the ranger's line.
    Asked {
        /// The bytes that were taken.
        bytes: Payload,
        /// When they were, if later.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        done_us: Option<u64>,
        /// The line is broken.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        broken: bool,
    },
    /// It waited for the line to have sent all until then.
    Flushed(u64),
    /// It moved the trigger pin.
    Trigger(bool),
    /// It moved an output.
    Set(Output, u8),
    /// Its state changed.
    State(RobotState, BehaviourName),
    /// It gave the network so many bytes.
    Sent {
        /// That were taken.
        bytes: u32,
        /// When they were, if later.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        done_us: Option<u64>,
        /// The connection is broken.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        broken: bool,
    },
    /// A message that it published is whole.
    Published {
        /// Its topic.
        topic: String,
        /// The message.
        payload: Payload,
        /// Its quality of service.
        qos: u8,
        /// Whether it is to be retained.
        retain: bool,
    },
    /// A message that it was sent is whole.
    Delivered {
        /// Its topic.
        topic: String,
        /// The message.
        payload: Payload,
    },
    /// It asked for a reset.
    Reset,
    /// It gave up waiting for a device to take something.
    GivenUp(Writer),
}

/// Something that a program gives a device and may have to wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Writer {
    /// Bytes for the ranger's line.
    Ask,
    /// The line is to send all it has.
    Flush,
    /// Bytes for the network.
    Send,
}

/// Why there is no picture; [`LensError`](crate::devices::LensError) in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "named like the errors they stand for")]
pub enum Lens {
    Length,
    TooLarge,
    Absent,
    Disconnected,
}

/// Why the flash refused; [`FlashError`](crate::devices::FlashError) in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "named like the errors they stand for")]
pub enum Flash {
    NotAligned,
    OutOfBounds,
    NotErased,
    PowerLost,
}

/// Why there is no network; [`NetError`] in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "named like the errors they stand for")]
pub enum Net {
    NotJoined,
    BadCredentials,
    NoAddress,
    UnknownHost,
    Refused,
    TimedOut,
    NoResources,
}

impl From<NetError> for Net {
    fn from(error: NetError) -> Self {
        match error {
            NetError::BadCredentials => Self::BadCredentials,
            NetError::NoAddress => Self::NoAddress,
            NetError::UnknownHost => Self::UnknownHost,
            NetError::Refused => Self::Refused,
            NetError::TimedOut => Self::TimedOut,
            NetError::NoResources => Self::NoResources,
            // The traits may learn of more; to a program they are all a network that is not there.
            _ => Self::NotJoined,
        }
    }
}

impl From<Net> for NetError {
    fn from(error: Net) -> Self {
        match error {
            Net::NotJoined => Self::NotJoined,
            Net::BadCredentials => Self::BadCredentials,
            Net::NoAddress => Self::NoAddress,
            Net::UnknownHost => Self::UnknownHost,
            Net::Refused => Self::Refused,
            Net::TimedOut => Self::TimedOut,
            Net::NoResources => Self::NoResources,
        }
    }
}
