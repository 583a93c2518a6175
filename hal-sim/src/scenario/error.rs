//! What can be wrong with a scenario.

use std::fmt;

use crawler_app::policy::PolicyError;
use crawler_protocol::IdError;

use super::{Place, Scenario};
use crate::world::ArenaError;

/// Why a scenario cannot be used.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ScenarioError {
    /// The text is not TOML, or has an unknown, missing or wrong key: what, and where.
    Text(String, Option<Place>),
    /// No scenario of that name comes with the program.
    Unknown(String),
    /// A value cannot be used: which, why, and where it stands.
    Value(String, String, Option<Place>),
    /// The arena is not sound.
    Arena(ArenaError),
    /// No place was found: for what, and in an arena of which size.
    NoRoom(String),
}

impl ScenarioError {
    pub(super) fn value(key: impl Into<String>, rule: impl Into<String>) -> Self {
        Self::Value(key.into(), rule.into(), None)
    }

    /// What serde or the parser said of `text`.
    pub(super) fn of_text(error: &toml::de::Error, text: &str) -> Self {
        let place = error.span().map(|span| Place::of(text, span.start));
        Self::Text(error.message().trim().to_owned(), place)
    }

    /// The same with the place at which `text` has the key that is meant.
    pub(super) fn located(self, text: &str) -> Self {
        match self {
            Self::Value(key, rule, None) => {
                let place = Place::of_key(text, &key);
                Self::Value(key, rule, place)
            }
            Self::Arena(error) => {
                let key = match error {
                    ArenaError::Obstacle(index) => format!("arena.obstacles[{index}]"),
                    ArenaError::Object(index) => format!("arena.objects[{index}]"),
                    ArenaError::Patch(index) => format!("arena.patches[{index}]"),
                    ArenaError::Mover(index) => format!("arena.movers[{index}]"),
                    ArenaError::Side => "arena".to_owned(),
                    ArenaError::TooManyObstacles => "arena.obstacles".to_owned(),
                    ArenaError::TooManyMovers => "arena.movers".to_owned(),
                    ArenaError::TooManyPatches => "arena.patches".to_owned(),
                };
                let place = Place::of_key(text, &key);
                Self::Value(key, format!("is not sound: {error}"), place)
            }
            other => other,
        }
    }

    /// The place in the file, where there is one.
    #[must_use]
    pub const fn place(&self) -> Option<Place> {
        match self {
            Self::Text(_, place) | Self::Value(_, _, place) => *place,
            Self::Unknown(_) | Self::Arena(_) | Self::NoRoom(_) => None,
        }
    }
}

/// Why robots cannot drive by a policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnusablePolicy {
    /// It is called what no policy can be.
    Name(IdError),
    /// Robots would refuse it.
    Blob(PolicyError),
}

impl fmt::Display for UnusablePolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(error) => error.fmt(f),
            Self::Blob(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for UnusablePolicy {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Name(error) => Some(error),
            Self::Blob(error) => Some(error),
        }
    }
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(place) = self.place() {
            write!(f, "{place}: ")?;
        }
        match self {
            Self::Text(text, _) => write!(f, "not a scenario: {text}"),
            Self::Unknown(name) => {
                write!(f, "no scenario is called {name:?}; there are")?;
                for (index, name) in Scenario::names().enumerate() {
                    write!(f, "{} {name}", if index == 0 { "" } else { "," })?;
                }
                Ok(())
            }
            Self::Value(key, rule, _) => write!(f, "{key} {rule}"),
            Self::Arena(error) => write!(f, "arena: {error}"),
            Self::NoRoom(what) => write!(f, "no room for {what}"),
        }
    }
}

impl std::error::Error for ScenarioError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Arena(error) => Some(error),
            Self::Text(..) | Self::Unknown(_) | Self::Value(..) | Self::NoRoom(_) => None,
        }
    }
}

impl From<ArenaError> for ScenarioError {
    fn from(error: ArenaError) -> Self {
        Self::Arena(error)
    }
}
