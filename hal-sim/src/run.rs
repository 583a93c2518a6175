//! Robots at work: a world, the real robot program in each body, and a way to the network.

pub mod bare;
pub(crate) mod control;
mod director;
mod error;
pub(crate) mod eyes;
pub mod hashes;
pub mod journal;
pub(crate) mod machine;
mod overhead;
pub mod parallel;
pub(crate) mod simulation;
#[cfg(feature = "recording")]
pub mod tape;

pub use control::FactorError;
pub use crawler_app::Credentials;
pub use crawler_hal::{Duration, Instant};
pub use director::{Broken, Issued, Target};
pub use error::SimulationError;
pub use eyes::Looks;
pub use machine::SimRobot;
pub use simulation::{EPOCH_MS, Link, Simulation, credentials};
