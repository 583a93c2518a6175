//! Which robots, and how many of them.

use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{ScenarioError, has_turn};

/// Some of the robots: `"all"`, a share (`0.5`), or a list of numbers counted from 0 (`[0, 3]`).
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Selector {
    /// Everyone.
    #[default]
    All,
    /// This share, 0 to 1. Robots take turns, so that any number has it as nearly as it can.
    Share(f32),
    /// These.
    List(Vec<u32>),
}

impl Selector {
    pub(super) fn is_all(&self) -> bool {
        *self == Self::All
    }

    /// Whether robot number `robot` is among them.
    #[must_use]
    pub fn has(&self, robot: usize) -> bool {
        match self {
            Self::All => true,
            Self::Share(share) => has_turn(robot, *share),
            Self::List(list) => list.iter().any(|&number| number as usize == robot),
        }
    }

    /// The first reason why what is at `key` cannot be meant for `robots` robots.
    pub(super) fn validate(&self, key: &str, robots: u32) -> Result<(), ScenarioError> {
        let rule = match self {
            Self::All => return Ok(()),
            Self::Share(share) if (0.0..=1.0).contains(share) => return Ok(()),
            Self::Share(share) => format!("must be a share of 0 to 1, not {share}"),
            Self::List(list) => match list.iter().find(|&&number| number >= robots) {
                Some(number) => format!(
                    "names robot {number}, and the last of {robots} is {}",
                    i64::from(robots) - 1
                ),
                None => return Ok(()),
            },
        };
        Err(ScenarioError::value(key, rule))
    }
}

impl Serialize for Selector {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_str("all"),
            Self::Share(share) => serializer.serialize_f32(*share),
            Self::List(list) => list.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Selector {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Words;
        impl<'de> Visitor<'de> for Words {
            type Value = Selector;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("\"all\", a share of 0 to 1, or a list of robots")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Selector, E> {
                if text == "all" {
                    Ok(Selector::All)
                } else {
                    Err(E::invalid_value(serde::de::Unexpected::Str(text), &self))
                }
            }

            fn visit_f64<E: Error>(self, share: f64) -> Result<Selector, E> {
                Ok(Selector::Share(share as f32))
            }

            fn visit_i64<E: Error>(self, share: i64) -> Result<Selector, E> {
                Ok(Selector::Share(share as f32))
            }

            fn visit_u64<E: Error>(self, share: u64) -> Result<Selector, E> {
                Ok(Selector::Share(share as f32))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Selector, A::Error> {
                let mut list = Vec::new();
                while let Some(number) = seq.next_element()? {
                    list.push(number);
                }
                Ok(Selector::List(list))
            }
        }
        deserializer.deserialize_any(Words)
    }
}

/// How many of all: `"all"`, `"any"`, or a share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Quota {
    /// Everyone.
    All,
    /// At least one.
    Any,
    /// At least this share, 0 to 1.
    Share(f32),
}

impl Quota {
    /// Whether `count` of `all` are enough. Nobody of nobody is.
    #[must_use]
    pub fn is_met(self, count: usize, all: usize) -> bool {
        match self {
            Self::All => count >= all,
            Self::Any => count > 0 || all == 0,
            // A share of 32 bits is seldom exact: nine of ten are 0.9 of them.
            Self::Share(share) => count as f64 + 1e-6 >= f64::from(share) * all as f64 - 1e-6,
        }
    }

    /// Why there can be no such quota at `key`.
    pub(super) fn validate(self, key: &str) -> Result<(), ScenarioError> {
        match self {
            Self::All | Self::Any => Ok(()),
            Self::Share(share) if (0.0..=1.0).contains(&share) => Ok(()),
            Self::Share(share) => {
                let rule = format!("must be 0 to 1, not {share}");
                Err(ScenarioError::value(key, rule))
            }
        }
    }
}

impl Serialize for Quota {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All => serializer.serialize_str("all"),
            Self::Any => serializer.serialize_str("any"),
            Self::Share(share) => serializer.serialize_f32(*share),
        }
    }
}

impl<'de> Deserialize<'de> for Quota {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Words;
        impl Visitor<'_> for Words {
            type Value = Quota;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("\"all\", \"any\" or a share of 0 to 1")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Quota, E> {
                match text {
                    "all" => Ok(Quota::All),
                    "any" => Ok(Quota::Any),
                    _ => Err(E::invalid_value(serde::de::Unexpected::Str(text), &self)),
                }
            }

            fn visit_f64<E: Error>(self, share: f64) -> Result<Quota, E> {
                Ok(Quota::Share(share as f32))
            }

            fn visit_i64<E: Error>(self, share: i64) -> Result<Quota, E> {
                Ok(Quota::Share(share as f32))
            }

            fn visit_u64<E: Error>(self, share: u64) -> Result<Quota, E> {
                Ok(Quota::Share(share as f32))
            }
        }
        deserializer.deserialize_any(Words)
    }
}
