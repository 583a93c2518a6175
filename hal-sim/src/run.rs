//! Robots at work: a world, the real robot program in each body, and a way to the network.
//!
//! Reading order: `machine` runs the program of one robot; `simulation` has all of them in a world
//! and lets time pass; `director`, `eyes` and `overhead` are the scenario, the detector behind the
//! lenses and the camera above the arena; `journal` and `hashes` are what was done to a simulation
//! and what came of it; `event_log` listens to devices. [`parallel`] cuts one simulation into shards,
//! [`bare`] does without the program.

pub mod bare;
pub(crate) mod control;
mod director;
mod error;
#[cfg(feature = "recording")]
pub mod event_log;
pub(crate) mod eyes;
pub mod hashes;
pub mod journal;
pub(crate) mod machine;
mod overhead;
pub mod parallel;
pub(crate) mod simulation;

use crawler_protocol::RobotId;

pub use control::FactorError;
pub use crawler_app::Credentials;
pub use crawler_hal::{Duration, Instant};
pub use director::{Broken, Issued, Target};
pub use error::SimulationError;
pub use eyes::Looks;
pub use machine::SimRobot;
pub use simulation::{EPOCH_MS, Link, Simulation, credentials};

/// The id of a simulated robot by its number, from 0 on.
fn robot_id(number: usize) -> RobotId {
    let name = format!("sim-{:04}", number + 1);
    // Letters, digits and a hyphen: always a valid id.
    RobotId::new(&name).unwrap_or_else(|_| unreachable!("{name} is a valid id"))
}
