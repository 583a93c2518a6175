//! The hardware of `crawler-hal` in software: device models, a world with physics, and the
//! scheduler that runs robot programs in it.
//!
//! A world is a value: the same seed and the same scenario give the same history,
//! byte for byte, on any number of threads and however many worlds run beside it.
//!
//! # Reading order
//! Each layer imports from those above it in this table alone; a test holds the modules to it.
//!
//! | modules | what they are |
//! |---|---|
//! | [`world`], [`sched`], [`faults`] | arena, bodies and physics; virtual time and its tasks; what can break |
//! | `render`, `net` | pictures of a world; ways to a broker, in virtual time and over sockets |
//! | [`devices`] | what `crawler-hal` abstracts, and a world with them in it |
//! | [`scenario`] | recipes for worlds |
//! | [`run`] | the robot program in every body: one simulation, several threads, or none of the program |
//! | [`evaluate`], [`tools`] | many runs and what they come to; record, replay, stop, keep, measure |
//! | `live`, `what_if` | a world in real time, on a thread of its own; a recorded run, and with something else in it |

/// Version of this crate.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

pub mod devices;
pub mod evaluate;
pub mod faults;
#[cfg(feature = "live")]
pub mod live;
pub mod net;
pub mod render;
pub mod run;
pub mod scenario;
pub mod sched;
pub mod tools;
#[cfg(feature = "recording")]
pub mod what_if;
pub mod world;
