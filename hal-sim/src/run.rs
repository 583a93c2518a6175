//! Robots at work: a world, the real robot program in each body, and a way to the network.

pub mod bare;
pub mod bench;
mod control;
mod debugger;
mod director;
mod error;
mod eyes;
pub mod hashes;
pub mod journal;
#[cfg(feature = "live")]
pub mod live;
mod machine;
pub mod parallel;
#[cfg(feature = "recording")]
pub mod recording;
#[cfg(feature = "recording")]
pub mod replay;
mod simulation;
pub mod snapshot;
mod tracker;

pub use crawler_app::Credentials;
pub use crawler_hal::{Duration, Instant};
pub use debugger::{Debugger, FactorError, Step};
pub use director::{Broken, Issued, Target};
pub use error::SimulationError;
pub use eyes::Looks;
pub use machine::SimRobot;
pub use simulation::{EPOCH_MS, Simulation, credentials};
pub use snapshot::Snapshot;
