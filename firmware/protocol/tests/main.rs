//! Every test of the messages from outside, in one program, which is linked once. cargo-nextest gives
//! each test a process of its own all the same.

mod command_syntax;
mod commands;
mod common;
mod contract;
mod faults;
mod golden;
mod hostile;
mod limits;
mod map;
mod open;
mod round_trip;
#[cfg(feature = "schema")]
mod schema;
mod telemetry_encodings;
mod topics;
mod updates;
