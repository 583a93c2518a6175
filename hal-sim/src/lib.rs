//! The hardware of `crawler-hal` in software: device models, a world with physics, and the
//! scheduler that runs robot programs in it.
//!
//! A world is a value: the same seed and the same scenario give the same history,
//! byte for byte, on any number of threads and however many worlds run beside it.
//!
//! Reading order, from below: `world`, `faults`, `sched` and `cells`; `net` and `render`; `devices`;
//! `scenario`; `run`; `evaluate` and `tools`; `live`.

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
pub mod world;
