//! Topics and messages of a fleet: the one definition that robot, server and control room share.
//!
//! Everything a robot and a server say to each other goes over MQTT 5, on a [`Topic`] below the name
//! of the [`Fleet`], as one JSON object of at most [`MAX_MESSAGE`] bytes; telemetry may also come
//! several samples at a time, and as CBOR ([`TelemetryEncoding`]):
//!
//! | topic | message |
//! |---|---|
//! | `command/…` | [`Command`] |
//! | `response/robot/{id}`, `response/swarm` | [`Response`], [`SwarmResponse`] |
//! | `status/{id}` | [`StatusMessage`] |
//! | `heartbeat/{id}` | [`Heartbeat`] |
//! | `telemetry/{id}` | [`Telemetry`] |
//! | `vision/{id}` | [`Detections`] |
//! | `logs/{id}` | [`LogRecord`] |
//! | `map/{id}` | [`MapSegment`] |
//! | `parameters/{id}` | [`ParametersMessage`] |
//! | `cell/{x}/{y}` | [`CellDigest`] |
//! | `pose/{id}` | [`PoseFix`] |
//! | `time` | [`TimeMessage`] |
//! | `ota/{id}` | [`UpdateCommand`], [`UpdateReport`]; chunks of a release, which are no JSON: `crawler-release` |
//! | `simulator/command` | [`FaultCommand`], and what only simulators are told: `crawler-sim-protocol` |
//!
//! Messages are read strictly, but for what robots say where [`open`] reads it: an unknown field, a field
//! twice, another type or a value out of range is an error with its own [`Reason`], and nothing that arrives can panic or take more memory than
//! the type it becomes. A number that is not finite never leaves: it is an error where it must be
//! there, and `null` where it may be missing.
//!
//! The crate has no heap and no `std`. Feature `schema` adds JSON Schemas of all messages for the
//! host.
//!
//! Reading order: [`ids`] and `topic`; `command` and `reason`; `message`, a file for each, and [`open`], which
//! reads those of robots that are newer; `fault`. Below
//! them: [`json`] reads and writes, `number`, `words` and [`fields`] are values in it, `schema` is for the
//! host. What is public of these is for crates that define more messages, read in the same way.
#![no_std]

#[cfg(any(feature = "schema", test))]
extern crate std;

mod command;
mod fault;
pub mod fields;
pub mod ids;
pub mod json;
mod message;
mod number;
pub mod open;
mod reason;
#[cfg(feature = "schema")]
pub mod schema;
mod topic;
mod words;

pub use command::{
    Action, BehaviourSpec, Command, CommandError, CommandName, DEFAULT_FOLLOW_DISTANCE,
    DEFAULT_LIARS, DEFAULT_WANDER_SPEED, Direction, FOLLOW_DISTANCE, Formation, MAX_COORDINATE,
    MAX_DRIVE_V, MAX_DRIVE_W, MAX_LAPS, MAX_LIARS, MAX_MOVE_MS, MAX_PLACES, MAX_SET, MAX_VALUE,
    Measure, ParameterValue, ParameterValues, Places, Shape,
};
pub use fault::{
    FaultCommand, FaultName, FaultRange, FaultSpec, LinkCut, MAX_CLOCK_STEP_MS, MAX_LASTING_MS,
    MAX_NOISE_MM, MAX_PACKETS_PER_S, MAX_SAG_OHM, Wheel,
};
pub use ids::{Fleet, IdError, MAX_ID, MAX_SOURCE, PolicyName, RobotId, Source};
pub use json::{DecodeError, EncodeError, MAX_DEPTH};
pub use message::{
    Battery, BehaviourName, Boot, BootCause, BuildId, Capability, CellDigest, Detection,
    Detections, Heartbeat, Kind, Level, LogRecord, MAX_BATCH, MAX_BUILD, MAX_DETECTIONS,
    MAX_MAP_BYTES, MAX_MAP_EDGE, MAX_MODEL, MAX_MODELS, MAX_NEIGHBOURS, MAX_PANIC, MAX_PARAMETERS,
    MAX_REASON_CODE, MAX_SAYS, MAX_WAY, MapCell, MapSegment, ModelName, Models, Neighbour,
    Outcomes, ParameterReport, ParametersMessage, Pose, PoseFix, ReasonCode, ReleaseId,
    ReleaseIdError, Reports, Response, RobotState, Samples, Says, Shadow, StatusMessage,
    SwarmResponse, Telemetry, TelemetryEncoding, TimeMessage, UpdateCommand, UpdateDelta,
    UpdateName, UpdateOutcome, UpdatePart, UpdateReport, UpdateStage, Wheels,
};
pub use reason::{Reason, ResponseStatus};
#[cfg(feature = "schema")]
pub use schema::schemas;
pub use topic::{Qos, Topic, TopicError, TopicFilter, TopicString};

/// Most bytes of one message; images and chunks of releases excepted.
pub const MAX_MESSAGE: usize = 1024;

/// Most bytes of what goes over `ota/{id}`: a chunk of a release is larger than a message by its header. It
/// stays below the largest packet that robots announce.
pub const MAX_OTA: usize = 1_100;

/// Most bytes of one image on `image/{id}`.
pub const MAX_IMAGE: usize = 60 * 1024;

/// User property of an image: its number, counting those of this boot, in decimal.
pub const IMAGE_FRAME: &str = "frame";

/// User property of an image: when it was taken, in Unix milliseconds and decimal; 0 while the
/// robot's clock was not synchronised.
pub const IMAGE_TIMESTAMP: &str = "timestamp";

/// Content type of an image.
pub const IMAGE_TYPE: &str = "image/jpeg";

/// Version of this contract, as reported in [`StatusMessage::protocol`].
pub const PROTOCOL_VERSION: u8 = 1;
