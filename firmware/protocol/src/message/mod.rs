//! The messages of a fleet, one module per topic.

mod cell;
mod detections;
mod log;
mod map;
mod parameters;
mod pose;
mod response;
mod says;
mod state;
mod status;
mod telemetry;
mod time;
mod update;

pub use cell::{CellDigest, MAX_NEIGHBOURS, Neighbour};
pub use detections::{Detection, Detections, MAX_DETECTIONS};
pub use log::{Level, LogRecord};
pub use map::{MAX_MAP_BYTES, MAX_MAP_EDGE, MAX_WAY, MapCell, MapSegment};
pub use parameters::{MAX_PARAMETERS, ParameterReport, ParametersMessage, Reports};
pub use pose::{Pose, PoseFix};
pub use response::{Outcomes, Response, SwarmResponse};
pub use says::{MAX_SAYS, Says};
pub use state::{BehaviourName, BootCause, Capability, Kind, RobotState};
pub use status::{Boot, MAX_MODELS, MAX_PANIC, Models, StatusMessage};
pub use telemetry::{
    Battery, Heartbeat, MAX_BATCH, Samples, Shadow, Telemetry, TelemetryEncoding, Wheels,
};
pub(crate) use telemetry::{Sample, cbor};
pub use time::TimeMessage;
pub use update::{
    BuildId, MAX_BUILD, MAX_MODEL, MAX_REASON_CODE, ModelName, ReasonCode, ReleaseId,
    ReleaseIdError, UpdateCommand, UpdateDelta, UpdateName, UpdateOutcome, UpdatePart,
    UpdateReport, UpdateStage,
};

/// Gives a message its way in and out of JSON, as inherent functions, so that nobody needs a trait
/// in scope.
macro_rules! wire {
    ($message:ty) => {
        impl $message {
            /// Writes the message as JSON to the front of `buf` and returns its length.
            ///
            /// # Errors
            /// [`EncodeError::TooLarge`](crate::EncodeError::TooLarge) when it does not fit `buf` or
            /// [`MAX_MESSAGE`](crate::MAX_MESSAGE); [`EncodeError::NotFinite`](crate::EncodeError::NotFinite)
            /// when a number that must be there is not one.
            pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, crate::EncodeError> {
                crate::json::to_slice(self, buf)
            }

            /// Reads the message from the whole of `payload`.
            ///
            /// # Errors
            /// [`DecodeError`](crate::DecodeError) names what is wrong with `payload`.
            pub fn from_json(payload: &[u8]) -> Result<Self, crate::DecodeError> {
                crate::json::from_slice(payload)
            }
        }
    };
}
pub(crate) use wire;
