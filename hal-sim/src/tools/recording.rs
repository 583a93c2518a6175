//! Recordings: what a world was, what happened in it, and what every program was told.
//!
//! A recording is an [MCAP](https://mcap.dev) file. The usual viewers show its scene, tables and
//! messages; [`replay`](super::replay) runs its inputs through the program once more. What it
//! holds is drawn from the outside, and from taps on the devices of every robot that change
//! nothing about the run.

mod error;
mod file;
mod recorder;
mod scene;
mod schema;

pub use error::RecordError;
pub use recorder::{RecordTo, Recorded, Recorder};

pub(crate) use file::{END, START, topics};
