//! What is kept of a calibration.

use std::fmt;

use crawler_protocol::RobotId;
use crawler_twin::certificate::Refused;
use serde::{Deserialize, Serialize};

/// How far a calibration is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Permitted; telemetry gets quicker.
    Preparing,
    /// The robot drives what is identified on.
    Baseline,
    /// The robot drives what is validated on.
    HeldOut,
    /// A body is identified, adjusted and validated.
    Identifying,
    /// It has a certificate.
    Certified,
    /// It drove, and there is no certificate.
    Refused,
    /// It did not come to its end.
    BrokenOff,
}

impl State {
    /// Its name, for programs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Preparing => "preparing",
            Self::Baseline => "baseline",
            Self::HeldOut => "held_out",
            Self::Identifying => "identifying",
            Self::Certified => "certified",
            Self::Refused => "refused",
            Self::BrokenOff => "broken_off",
        }
    }

    /// Whether nothing more happens.
    #[must_use]
    pub const fn is_over(self) -> bool {
        matches!(self, Self::Certified | Self::Refused | Self::BrokenOff)
    }
}

/// Why there is no certificate: a name for programs, and a text for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// Its name.
    pub code: String,
    /// For people.
    pub detail: String,
}

/// Why a drive was broken off.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum BrokenOff {
    /// A person stopped it.
    Stopped(String),
    /// Somebody else told the robot something.
    OtherCommand(String),
    /// The robot left the area.
    LeftArea,
    /// Another robot came too near.
    RobotNear(String),
    /// No fix came for a while.
    TrackerLost,
    /// The tracker, or the robot, was elsewhere at once.
    Jumped,
    /// Nothing was heard of the robot for a while, or nothing can be told to it.
    LinkLost,
    /// The robot stands until somebody sees to it.
    Halted,
    /// It started anew.
    Restarted,
    /// It did not do what it was told.
    RobotRefused(String),
    /// It did not tell its duties, or the tracker fixes, often enough to begin.
    TooLittle,
    /// What identifies ended badly.
    Failed,
    /// The server ended.
    ServerEnded,
}

impl BrokenOff {
    /// Its name, for programs.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Stopped(_) => "stopped",
            Self::OtherCommand(_) => "other_command",
            Self::LeftArea => "left_area",
            Self::RobotNear(_) => "robot_near",
            Self::TrackerLost => "tracker_lost",
            Self::Jumped => "jumped",
            Self::LinkLost => "link_lost",
            Self::Halted => "halted",
            Self::Restarted => "restarted",
            Self::RobotRefused(_) => "robot_refused",
            Self::TooLittle => "too_little",
            Self::Failed => "failed",
            Self::ServerEnded => "server_ended",
        }
    }
}

impl fmt::Display for BrokenOff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stopped(who) => write!(f, "{who} stopped it"),
            Self::OtherCommand(who) => write!(f, "{who} told the robot something else"),
            Self::LeftArea => f.write_str("the robot left the area that was permitted"),
            Self::RobotNear(robot) => write!(f, "robot {robot} came too near"),
            Self::TrackerLost => f.write_str("the tracker did not tell where the robot is"),
            Self::Jumped => f.write_str(
                "the robot was elsewhere at once: it was carried, or the tracker took another one for it",
            ),
            Self::LinkLost => f.write_str("nothing was heard of the robot, or nothing reaches it"),
            Self::Halted => f.write_str("the robot stands until somebody sees to it"),
            Self::Restarted => f.write_str("the robot started anew"),
            Self::RobotRefused(why) => write!(f, "the robot did not do what it was told: {why}"),
            Self::TooLittle => f.write_str(
                "the robot did not tell its duties ten times a second, or the tracker fixes twice a second",
            ),
            Self::Failed => f.write_str("an internal error"),
            Self::ServerEnded => f.write_str("the server ended meanwhile"),
        }
    }
}

impl From<&BrokenOff> for Reason {
    fn from(broken: &BrokenOff) -> Self {
        Self {
            code: broken.name().to_owned(),
            detail: broken.to_string(),
        }
    }
}

impl From<&Refused> for Reason {
    fn from(refused: &Refused) -> Self {
        Self {
            code: refused.name().to_owned(),
            detail: refused.to_string(),
        }
    }
}

/// How a drive that was held out is predicted, metres off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// How far ahead, seconds.
    pub ahead_s: f64,
    /// Half of the predictions were off by less, and nine in ten: by the new body.
    pub own: [f64; 2],
    /// By the nominal one.
    pub nominal: [f64; 2],
    /// By that of the certificate before, where there was one.
    pub previous: Option<[f64; 2]>,
}

/// A calibration, as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Its number.
    pub id: u64,
    /// Of which robot.
    pub robot: RobotId,
    /// Who asked for it.
    pub by: String,
    /// What the robot drives on, in words; empty where nobody said.
    pub floor: String,
    /// Unix milliseconds.
    pub begun: u64,
    /// Unix milliseconds; `None` while it goes on.
    pub ended: Option<u64>,
    /// How far it is.
    pub state: State,
    /// How long the drive takes, seconds.
    pub seconds: f64,
    /// Legs of it that were begun, and all of them.
    pub legs: [usize; 2],
    /// Corners of the floor that was permitted, metres.
    pub area: Vec<[f64; 2]>,
    /// Why there is no certificate.
    pub reason: Option<Reason>,
    /// Id of the certificate.
    pub certificate: Option<String>,
    /// How the part of the drive is predicted that was held out.
    pub errors: Vec<Errors>,
    /// How long identification and validation took, seconds.
    pub took_s: Option<f64>,
    /// How often the robot told telemetry before; what is to be set again.
    pub telemetry_hz: Option<f32>,
}
