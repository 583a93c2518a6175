//! Why a world or a robot in it cannot be made.

use super::{ArenaError, ParameterError};

/// Why a world cannot be made.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum WorldError {
    /// The arena is not sound.
    Arena(ArenaError),
    /// A parameter is out of range.
    Parameter(ParameterError),
}

impl core::fmt::Display for WorldError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Arena(error) => write!(f, "arena: {error}"),
            Self::Parameter(error) => write!(f, "parameters: {error}"),
        }
    }
}

impl core::error::Error for WorldError {}

impl From<ArenaError> for WorldError {
    fn from(error: ArenaError) -> Self {
        Self::Arena(error)
    }
}

impl From<ParameterError> for WorldError {
    fn from(error: ParameterError) -> Self {
        Self::Parameter(error)
    }
}

/// Why a robot cannot be placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlacementError {
    /// A coordinate is not a finite number.
    NotFinite,
    /// A wall, an obstacle or another robot is there.
    Occupied,
    /// The world holds [`super::MAX_ROBOTS`] already.
    Full,
}

impl core::fmt::Display for PlacementError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "the pose is not finite",
            Self::Occupied => "the place is occupied",
            Self::Full => "the world is full",
        })
    }
}

impl core::error::Error for PlacementError {}
