//! Every test of commands to a simulated world, in one program, which is linked once.

mod commands;
mod common;
mod corpus;
#[path = "../../../firmware/protocol/tests/common/faults.rs"]
mod faults;
#[path = "../../../firmware/protocol/tests/common/respell.rs"]
mod respell;
mod round_trip;
#[cfg(feature = "schema")]
mod schema;
