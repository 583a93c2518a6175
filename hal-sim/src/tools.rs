//! What people do with worlds: record and replay them, stop and step them, keep them, measure
//! them, and draw data sets from them.

pub mod bench;
pub mod dataset;
pub mod debugger;
#[cfg(feature = "recording")]
pub mod recording;
#[cfg(feature = "recording")]
pub mod replay;
pub mod snapshot;
