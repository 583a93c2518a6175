//! Why simulations cannot be set up.

use std::fmt;

use crawler_app::vision::DetectorError;

use crate::scenario::ScenarioError;
use crate::world::{PlacementError, WorldError};

/// Why a simulation cannot be set up.
#[derive(Debug)]
#[non_exhaustive]
pub enum SimulationError {
    /// The scenario cannot be used.
    Scenario(ScenarioError),
    /// The world cannot be built.
    World(WorldError),
    /// A robot found no place: its number, of how many.
    NoRoom(u32, u32),
    /// A robot cannot be put there.
    Placement(PlacementError),
    /// A name or password for the broker is too long.
    Credentials,
    /// The scenario's detector is none.
    Detector(DetectorError),
    /// It is live: its robots talk to a real broker, and only its owner can begin it again.
    Live,
}

impl fmt::Display for SimulationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scenario(error) => write!(f, "scenario: {error}"),
            Self::World(error) => write!(f, "world: {error}"),
            Self::NoRoom(number, all) => {
                write!(
                    f,
                    "no room for robot {number} of {all}: make the arena larger"
                )
            }
            Self::Placement(error) => write!(f, "placing a robot: {error}"),
            Self::Detector(error) => write!(f, "the detector: {error}"),
            Self::Live => f.write_str("a live simulation begins again by its own command"),
            Self::Credentials => f.write_str("at most 32 bytes of name and 64 of password"),
        }
    }
}

impl std::error::Error for SimulationError {}

impl From<ScenarioError> for SimulationError {
    fn from(error: ScenarioError) -> Self {
        Self::Scenario(error)
    }
}

impl From<DetectorError> for SimulationError {
    fn from(error: DetectorError) -> Self {
        Self::Detector(error)
    }
}

impl From<WorldError> for SimulationError {
    fn from(error: WorldError) -> Self {
        Self::World(error)
    }
}

impl From<PlacementError> for SimulationError {
    fn from(error: PlacementError) -> Self {
        Self::Placement(error)
    }
}
