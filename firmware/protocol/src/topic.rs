//! The topics of a fleet, their quality of service, and the filters that select them.

use core::fmt::Write as _;

use heapless::String;

use crate::{Fleet, RobotId};

/// A rendered topic or filter. The longest is 32 bytes of fleet, 32 of robot id and the words between.
pub type TopicString = String<96>;

/// Quality of service of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Qos {
    /// QoS 0: may be lost.
    AtMostOnce,
    /// QoS 1: arrives, perhaps twice.
    AtLeastOnce,
}

/// Why a text is not a topic of this fleet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TopicError {
    /// The first level is another fleet.
    OtherFleet,
    /// The levels after the fleet are no topic of this contract.
    Unknown,
    /// The level that names a robot is not a robot id.
    Robot,
    /// The levels that name a cell are not two whole numbers in plain decimal.
    Cell,
}

impl core::fmt::Display for TopicError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::OtherFleet => "a topic of another fleet",
            Self::Unknown => "not a topic of a fleet",
            Self::Robot => "not a robot id",
            Self::Cell => "not the numbers of a cell",
        })
    }
}

impl core::error::Error for TopicError {}

/// A topic of a fleet, without the fleet's name.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Topic {
    /// `command/swarm`: a [`Command`](crate::Command) to every robot.
    CommandSwarm,
    /// `command/robot/{id}`: a [`Command`](crate::Command) to one robot.
    CommandRobot(RobotId),
    /// `command/experiment`: a [`Command`](crate::Command) to the participants of an experiment.
    CommandExperiment,
    /// `response/robot/{id}`: a [`Response`](crate::Response).
    Response(RobotId),
    /// `response/swarm`: a [`SwarmResponse`](crate::SwarmResponse).
    ResponseSwarm,
    /// `status/{id}`: a [`StatusMessage`](crate::StatusMessage).
    Status(RobotId),
    /// `heartbeat/{id}`: a [`Heartbeat`](crate::Heartbeat).
    Heartbeat(RobotId),
    /// `telemetry/{id}`: a [`Telemetry`](crate::Telemetry).
    Telemetry(RobotId),
    /// `vision/{id}`: [`Detections`](crate::Detections).
    Vision(RobotId),
    /// `image/{id}`: a JPEG; user properties name frame and time.
    Image(RobotId),
    /// `logs/{id}`: a [`LogRecord`](crate::LogRecord).
    Logs(RobotId),
    /// `map/{id}`: a [`MapSegment`](crate::MapSegment).
    Map(RobotId),
    /// `parameters/{id}`: a [`ParametersMessage`](crate::ParametersMessage).
    Parameters(RobotId),
    /// `cell/{x}/{y}`: a [`CellDigest`](crate::CellDigest).
    Cell {
        /// Column of the cell.
        x: i16,
        /// Row of the cell.
        y: i16,
    },
    /// `pose/{id}`: a [`PoseFix`](crate::PoseFix).
    Pose(RobotId),
    /// `time`: a [`TimeMessage`](crate::TimeMessage).
    Time,
    /// `ota/{id}`: an [`UpdateCommand`](crate::UpdateCommand) or an [`UpdateReport`](crate::UpdateReport) at
    /// the quality of service of the topic, and chunks of a release at QoS 0.
    Ota(RobotId),
    /// `simulator/command`: what a simulator is told, and of that a [`FaultCommand`](crate::FaultCommand)
    /// to robots on a bench.
    SimulatorCommand,
    /// `simulator/experiment`: scenario control of an experiment.
    SimulatorExperiment,
}

/// Why pushing cannot fail: the longest topic is `{32}/response/robot/{32}`, 80 bytes of 96.
fn render(fleet: &Fleet, rest: core::fmt::Arguments<'_>) -> TopicString {
    let mut topic = TopicString::new();
    let fits = write!(topic, "{fleet}/{rest}").is_ok();
    debug_assert!(fits, "a topic longer than its type");
    topic
}

/// The same of levels that are texts already: most topics, at every message.
fn join(fleet: &Fleet, levels: &[&str]) -> TopicString {
    let mut topic = TopicString::new();
    let mut fits = topic.push_str(fleet.as_str()).is_ok();
    for level in levels {
        fits = fits && topic.push('/').is_ok() && topic.push_str(level).is_ok();
    }
    debug_assert!(fits, "a topic longer than its type");
    topic
}

impl Topic {
    /// The topic as it goes on the wire.
    #[must_use]
    pub fn render(&self, fleet: &Fleet) -> TopicString {
        match self {
            Self::CommandSwarm => join(fleet, &["command", "swarm"]),
            Self::CommandRobot(id) => join(fleet, &["command", "robot", id.as_str()]),
            Self::CommandExperiment => join(fleet, &["command", "experiment"]),
            Self::Response(id) => join(fleet, &["response", "robot", id.as_str()]),
            Self::ResponseSwarm => join(fleet, &["response", "swarm"]),
            Self::Status(id) => join(fleet, &["status", id.as_str()]),
            Self::Heartbeat(id) => join(fleet, &["heartbeat", id.as_str()]),
            Self::Telemetry(id) => join(fleet, &["telemetry", id.as_str()]),
            Self::Vision(id) => join(fleet, &["vision", id.as_str()]),
            Self::Image(id) => join(fleet, &["image", id.as_str()]),
            Self::Logs(id) => join(fleet, &["logs", id.as_str()]),
            Self::Map(id) => join(fleet, &["map", id.as_str()]),
            Self::Parameters(id) => join(fleet, &["parameters", id.as_str()]),
            Self::Cell { x, y } => render(fleet, format_args!("cell/{x}/{y}")),
            Self::Pose(id) => join(fleet, &["pose", id.as_str()]),
            Self::Time => join(fleet, &["time"]),
            Self::Ota(id) => join(fleet, &["ota", id.as_str()]),
            Self::SimulatorCommand => join(fleet, &["simulator", "command"]),
            Self::SimulatorExperiment => join(fleet, &["simulator", "experiment"]),
        }
    }

    /// Reads a topic. Every text has at most one reading, and every reading renders to the same text.
    ///
    /// # Errors
    /// [`TopicError`] says which part is not what it must be.
    pub fn parse(fleet: &Fleet, topic: &str) -> Result<Self, TopicError> {
        let rest = topic
            .strip_prefix(fleet.as_str())
            .and_then(|rest| rest.strip_prefix('/'))
            .ok_or(TopicError::OtherFleet)?;
        let mut levels = rest.split('/');
        let first = levels.next().ok_or(TopicError::Unknown)?;
        let second = levels.next();
        let third = levels.next();
        if levels.next().is_some() {
            return Err(TopicError::Unknown);
        }
        let robot = |text: &str| RobotId::new(text).map_err(|_| TopicError::Robot);
        match (first, second, third) {
            ("command", Some("swarm"), None) => Ok(Self::CommandSwarm),
            ("command", Some("experiment"), None) => Ok(Self::CommandExperiment),
            ("command", Some("robot"), Some(id)) => robot(id).map(Self::CommandRobot),
            ("response", Some("swarm"), None) => Ok(Self::ResponseSwarm),
            ("response", Some("robot"), Some(id)) => robot(id).map(Self::Response),
            ("status", Some(id), None) => robot(id).map(Self::Status),
            ("heartbeat", Some(id), None) => robot(id).map(Self::Heartbeat),
            ("telemetry", Some(id), None) => robot(id).map(Self::Telemetry),
            ("vision", Some(id), None) => robot(id).map(Self::Vision),
            ("image", Some(id), None) => robot(id).map(Self::Image),
            ("logs", Some(id), None) => robot(id).map(Self::Logs),
            ("map", Some(id), None) => robot(id).map(Self::Map),
            ("parameters", Some(id), None) => robot(id).map(Self::Parameters),
            ("cell", Some(x), Some(y)) => Ok(Self::Cell {
                x: cell_number(x)?,
                y: cell_number(y)?,
            }),
            ("pose", Some(id), None) => robot(id).map(Self::Pose),
            ("time", None, None) => Ok(Self::Time),
            ("ota", Some(id), None) => robot(id).map(Self::Ota),
            ("simulator", Some("command"), None) => Ok(Self::SimulatorCommand),
            ("simulator", Some("experiment"), None) => Ok(Self::SimulatorExperiment),
            _ => Err(TopicError::Unknown),
        }
    }

    /// Quality of service with which the topic is published and subscribed.
    #[must_use]
    pub const fn qos(&self) -> Qos {
        match self {
            Self::CommandSwarm
            | Self::CommandRobot(_)
            | Self::CommandExperiment
            | Self::Response(_)
            | Self::ResponseSwarm
            | Self::Status(_)
            | Self::Image(_)
            | Self::Parameters(_)
            | Self::Ota(_)
            | Self::SimulatorCommand
            | Self::SimulatorExperiment => Qos::AtLeastOnce,
            Self::Heartbeat(_)
            | Self::Telemetry(_)
            | Self::Vision(_)
            | Self::Logs(_)
            | Self::Map(_)
            | Self::Cell { .. }
            | Self::Pose(_)
            | Self::Time => Qos::AtMostOnce,
        }
    }

    /// Whether the broker keeps the last message for later subscribers.
    #[must_use]
    pub const fn retained(&self) -> bool {
        matches!(self, Self::Status(_) | Self::Parameters(_))
    }

    /// The robot that the topic names, if it names one.
    #[must_use]
    pub const fn robot(&self) -> Option<&RobotId> {
        match self {
            Self::CommandRobot(id)
            | Self::Response(id)
            | Self::Status(id)
            | Self::Heartbeat(id)
            | Self::Telemetry(id)
            | Self::Vision(id)
            | Self::Image(id)
            | Self::Logs(id)
            | Self::Map(id)
            | Self::Parameters(id)
            | Self::Pose(id)
            | Self::Ota(id) => Some(id),
            Self::CommandSwarm
            | Self::CommandExperiment
            | Self::ResponseSwarm
            | Self::Cell { .. }
            | Self::Time
            | Self::SimulatorCommand
            | Self::SimulatorExperiment => None,
        }
    }
}

/// One number has one spelling: no plus sign, no leading zero, no minus zero.
fn cell_number(text: &str) -> Result<i16, TopicError> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let plain = match digits.as_bytes() {
        [b'0'] => digits.len() == text.len(),
        [b'1'..=b'9', rest @ ..] => rest.iter().all(u8::is_ascii_digit),
        _ => false,
    };
    if !plain {
        return Err(TopicError::Cell);
    }
    text.parse().map_err(|_| TopicError::Cell)
}

/// What a server subscribes to: one kind of topic of every robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TopicFilter {
    /// `command/swarm`, `command/experiment`, `command/robot/+`.
    Commands,
    /// `response/robot/+`.
    Responses,
    /// `response/swarm`.
    ResponseSwarm,
    /// `status/+`.
    Status,
    /// `heartbeat/+`.
    Heartbeat,
    /// `telemetry/+`.
    Telemetry,
    /// `vision/+`.
    Vision,
    /// `image/+`.
    Image,
    /// `logs/+`.
    Logs,
    /// `map/+`.
    Map,
    /// `parameters/+`.
    Parameters,
    /// `cell/+/+`.
    Cells,
    /// `pose/+`.
    Pose,
    /// `time`.
    Time,
    /// `ota/+`.
    Ota,
    /// `simulator/+`.
    Simulator,
}

impl TopicFilter {
    /// Every filter.
    pub const ALL: [Self; 16] = [
        Self::Commands,
        Self::Responses,
        Self::ResponseSwarm,
        Self::Status,
        Self::Heartbeat,
        Self::Telemetry,
        Self::Vision,
        Self::Image,
        Self::Logs,
        Self::Map,
        Self::Parameters,
        Self::Cells,
        Self::Pose,
        Self::Time,
        Self::Ota,
        Self::Simulator,
    ];

    /// The filter without the fleet.
    const fn levels(self) -> &'static str {
        match self {
            Self::Commands => "command/#",
            Self::Responses => "response/robot/+",
            Self::ResponseSwarm => "response/swarm",
            Self::Status => "status/+",
            Self::Heartbeat => "heartbeat/+",
            Self::Telemetry => "telemetry/+",
            Self::Vision => "vision/+",
            Self::Image => "image/+",
            Self::Logs => "logs/+",
            Self::Map => "map/+",
            Self::Parameters => "parameters/+",
            Self::Cells => "cell/+/+",
            Self::Pose => "pose/+",
            Self::Time => "time",
            Self::Ota => "ota/+",
            Self::Simulator => "simulator/+",
        }
    }

    /// The filter as it goes on the wire.
    #[must_use]
    pub fn render(self, fleet: &Fleet) -> TopicString {
        render(fleet, format_args!("{}", self.levels()))
    }

    /// Whether the filter selects `topic`.
    #[must_use]
    pub const fn matches(self, topic: &Topic) -> bool {
        matches!(
            (self, topic),
            (
                Self::Commands,
                Topic::CommandSwarm | Topic::CommandExperiment | Topic::CommandRobot(_)
            ) | (Self::Responses, Topic::Response(_))
                | (Self::ResponseSwarm, Topic::ResponseSwarm)
                | (Self::Status, Topic::Status(_))
                | (Self::Heartbeat, Topic::Heartbeat(_))
                | (Self::Telemetry, Topic::Telemetry(_))
                | (Self::Vision, Topic::Vision(_))
                | (Self::Image, Topic::Image(_))
                | (Self::Logs, Topic::Logs(_))
                | (Self::Map, Topic::Map(_))
                | (Self::Parameters, Topic::Parameters(_))
                | (Self::Cells, Topic::Cell { .. })
                | (Self::Pose, Topic::Pose(_))
                | (Self::Time, Topic::Time)
                | (Self::Ota, Topic::Ota(_))
                | (
                    Self::Simulator,
                    Topic::SimulatorCommand | Topic::SimulatorExperiment
                )
        )
    }

    /// Quality of service to ask for: that of the topics it selects.
    #[must_use]
    pub const fn qos(self) -> Qos {
        match self {
            Self::Commands
            | Self::Responses
            | Self::ResponseSwarm
            | Self::Status
            | Self::Image
            | Self::Parameters
            | Self::Ota
            | Self::Simulator => Qos::AtLeastOnce,
            Self::Heartbeat
            | Self::Telemetry
            | Self::Vision
            | Self::Logs
            | Self::Map
            | Self::Cells
            | Self::Pose
            | Self::Time => Qos::AtMostOnce,
        }
    }
}
