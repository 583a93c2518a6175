//! Updates: what servers and robots say to each other on `ota/{id}`.
//!
//! A topic carries both directions, so every message says by `update` what it is, and whoever meets one of
//! their own kind passes over it. Chunks of a release come on the same topic; they are no JSON, and begin with
//! another byte than `{`. What a chunk and a window of chunks are says `crawler-release`, on which this crate
//! does not depend: whoever knows both, the robot's program and the server, makes [`UpdateReport::Want`]
//! of its windows and back.

mod command;
mod names;
mod read;
mod report;

pub use command::{UpdateCommand, UpdateDelta};
pub use names::{
    BuildId, MAX_BUILD, MAX_MODEL, MAX_REASON_CODE, ModelName, ReasonCode, ReleaseId,
    ReleaseIdError, UpdateName, UpdateOutcome, UpdatePart, UpdateStage,
};
pub use report::UpdateReport;
