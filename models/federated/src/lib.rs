//! Learning together: nodes train one policy in worlds of their own, and tell nothing but what it became there.
//!
//! A run goes on round by round. The coordinator [announces](Announcement) weights; each node trains them for a while, and
//! answers with its [`Update`], which is the difference to what it became, in 8 bits a weight. Once enough nodes
//! have answered, the updates [become one](aggregation), and the next round begins (`McMahan` and others 2017, federated averaging).
//!
//! Nothing here knows what the weights are for, opens a connection or reads a clock: times are handed in, and messages are bytes.
//! What comes in is believed in nothing. Bytes that are no message get a reason, who answers twice counts once, and who is wrong on
//! purpose is what the rules other than the mean are for.
//!
//! Reading order: `quantise`, from floats to 8 bits and back; `message`, what goes over the wire; `aggregation`, from many updates to one;
//! `coordinator`, the rounds; `checkpoint`, what it keeps.
#![forbid(unsafe_code)]

pub mod aggregation;
mod checkpoint;
pub mod coordinator;
pub mod message;
pub mod quantise;

pub use aggregation::Aggregation;
pub use checkpoint::CheckpointError;
pub use coordinator::{Coordinator, Settings};
pub use message::{Announcement, MessageError, Plan, Report, Update};
