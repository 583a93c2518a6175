//! Robots at work: a world, the real robot program in each body, and a way to the network.

pub mod bench;
mod error;
mod fingerprint;
#[cfg(feature = "live")]
pub mod live;
mod machine;
mod simulation;
mod tracker;

pub use crawler_app::Credentials;
pub use error::SimulationError;
pub use fingerprint::Fingerprint;
pub use machine::SimRobot;
pub use simulation::{EPOCH_MS, Simulation, credentials};
#[cfg(feature = "live")]
pub(crate) use tracker::compose as compose_fix;
