//! Why worlds cannot be kept, or made again.

use std::fmt;

use super::BUILD;
use crate::run::SimulationError;

/// Why a world cannot be kept.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum SnapshotError {
    /// Its robots talk to a real broker, whose side of the story cannot be repeated.
    Live,
    /// So many inputs did not fit the journal.
    Lost(u64),
    /// So many inputs were secret, and are not in the journal.
    Withheld(u64),
    /// The file would be larger than [`MAX_FILE`](super::MAX_FILE).
    TooLarge,
    /// The scenario cannot be written so that it reads the same.
    Scenario(String),
}

impl fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Live => f.write_str(
                "a live world cannot be kept: its robots talk to a real broker, in real time, and \
                 neither can be run again; worlds in lockstep can",
            ),
            Self::Lost(count) => write!(
                f,
                "the journal was full and does not hold {count} inputs of this world"
            ),
            Self::Withheld(count) => write!(
                f,
                "passwords are not written down, and {count} were given to this world"
            ),
            Self::TooLarge => f.write_str("it is larger than a snapshot file may be"),
            Self::Scenario(error) => write!(f, "the scenario cannot be written: {error}"),
        }
    }
}

impl std::error::Error for SnapshotError {}

/// Why a world cannot be made again.
#[derive(Debug)]
#[non_exhaustive]
pub enum RestoreError {
    /// The bytes are no snapshot, or a damaged one: what is wrong.
    File(String),
    /// The simulation cannot be set up.
    Simulation(SimulationError),
    /// The recording of the world that is made takes no more.
    #[cfg(feature = "recording")]
    Record(crate::tools::recording::RecordError),
    /// The same recipe made another world.
    Differs {
        /// The first second in which it did, counting from 1.
        second: u64,
        /// The build that took the snapshot.
        made_by: String,
    },
}

impl fmt::Display for RestoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(text) => write!(f, "not a usable snapshot: {text}"),
            Self::Simulation(error) => error.fmt(f),
            #[cfg(feature = "recording")]
            Self::Record(error) => error.fmt(f),
            Self::Differs { second, made_by } => write!(
                f,
                "the same scenario, seed and inputs make another world from second {second} on: \
                 it was kept by another program (version {made_by}, this is {BUILD})"
            ),
        }
    }
}

impl std::error::Error for RestoreError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Simulation(error) => Some(error),
            #[cfg(feature = "recording")]
            Self::Record(error) => Some(error),
            Self::File(_) | Self::Differs { .. } => None,
        }
    }
}

#[cfg(feature = "recording")]
impl From<crate::tools::recording::RecordError> for RestoreError {
    fn from(error: crate::tools::recording::RecordError) -> Self {
        Self::Record(error)
    }
}

impl From<SimulationError> for RestoreError {
    fn from(error: SimulationError) -> Self {
        Self::Simulation(error)
    }
}
