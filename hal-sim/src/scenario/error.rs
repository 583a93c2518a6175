//! What can be wrong with a scenario.

use std::fmt;

use super::Scenario;
use crate::world::ArenaError;

/// Why a scenario cannot be used.
#[derive(Debug)]
#[non_exhaustive]
pub enum ScenarioError {
    /// The text is not TOML, or has an unknown, missing or wrong key.
    Text(Box<toml::de::Error>),
    /// No scenario of that name comes with the program.
    Unknown(String),
    /// A value is out of range: which, and what it may be.
    Value(&'static str, String),
    /// The command is none: why.
    Command(String),
    /// The arena is not sound.
    Arena(ArenaError),
    /// No place was found: for what, and in an arena of which size.
    NoRoom(String),
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(error) => write!(f, "not a scenario: {error}"),
            Self::Unknown(name) => {
                write!(f, "no scenario is called {name:?}; there are")?;
                for (index, name) in Scenario::names().enumerate() {
                    write!(f, "{} {name}", if index == 0 { "" } else { "," })?;
                }
                Ok(())
            }
            Self::Value(key, rule) => write!(f, "{key} {rule}"),
            Self::Command(why) => write!(f, "command: {why}"),
            Self::Arena(error) => write!(f, "arena: {error}"),
            Self::NoRoom(what) => write!(f, "no room for {what}"),
        }
    }
}

impl std::error::Error for ScenarioError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Text(error) => Some(error),
            Self::Arena(error) => Some(error),
            Self::Unknown(_) | Self::Value(..) | Self::Command(_) | Self::NoRoom(_) => None,
        }
    }
}

impl From<ArenaError> for ScenarioError {
    fn from(error: ArenaError) -> Self {
        Self::Arena(error)
    }
}
