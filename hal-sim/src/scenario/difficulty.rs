//! One number that makes a scenario easier or harder.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Scenario, ScenarioError};

/// How hard a scenario is, and what that changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Difficulty {
    /// From 0, easy, to 1, hard. Without it, that of `level`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f32>,
    /// One of `levels`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub level: Option<String>,
    /// Names for difficulties.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub levels: BTreeMap<String, f32>,
    /// Keys of the scenario, each with its values at 0 and at 1. Where both are whole numbers, so
    /// is what lies between.
    pub keys: BTreeMap<String, [toml::Value; 2]>,
}

impl Difficulty {
    /// The difficulty as a number; 0.5 when none is given.
    ///
    /// # Errors
    /// When it is out of range, or no such level exists.
    pub fn number(&self) -> Result<f32, ScenarioError> {
        for (name, value) in &self.levels {
            in_range(&format!("difficulty.levels.{name}"), *value)?;
        }
        match (self.value, &self.level) {
            (Some(_), Some(_)) => {
                let rule = "and difficulty.value exclude each other";
                Err(ScenarioError::value("difficulty.level", rule))
            }
            (Some(value), None) => in_range("difficulty.value", value),
            (None, Some(name)) => self.level(name),
            (None, None) => Ok(0.5),
        }
    }

    fn level(&self, name: &str) -> Result<f32, ScenarioError> {
        self.levels.get(name).copied().ok_or_else(|| {
            let known: Vec<_> = self.levels.keys().map(String::as_str).collect();
            let rule = format!("{name:?} is none of {}", known.join(", "));
            ScenarioError::value("difficulty.level", rule)
        })
    }
}

fn in_range(key: &str, value: f32) -> Result<f32, ScenarioError> {
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err(ScenarioError::value(
            key,
            format!("must be 0 to 1, not {value}"),
        ))
    }
}

impl Scenario {
    /// The same at another difficulty: a number from 0 to 1, or the name of a level.
    ///
    /// # Errors
    /// When the scenario has no difficulty, or none of that name, or cannot be as hard as that.
    pub fn with_difficulty(mut self, difficulty: &str) -> Result<Self, ScenarioError> {
        let Some(own) = &mut self.difficulty else {
            let rule = "is not stated by this scenario, so there is nothing to change";
            return Err(ScenarioError::value("difficulty", rule));
        };
        let number = match difficulty.parse() {
            Ok(number) => in_range("difficulty", number)?,
            Err(_) => own.level(difficulty)?,
        };
        own.value = Some(number);
        own.level = None;
        self.at_its_difficulty()
    }

    /// Puts the values in that its difficulty asks for.
    pub(super) fn at_its_difficulty(self) -> Result<Self, ScenarioError> {
        let Some(difficulty) = self.difficulty.clone() else {
            return Ok(self);
        };
        let share = f64::from(difficulty.number()?);
        let mut scenario = self;
        for (key, ends) in &difficulty.keys {
            let fail = |rule: String| ScenarioError::value("difficulty.keys", rule);
            if key == "difficulty" || key.starts_with("difficulty.") {
                return Err(fail(format!("cannot contain {key}")));
            }
            let value = between(ends, share)
                .ok_or_else(|| fail(format!("needs two finite numbers for {key}")))?;
            scenario = scenario
                .with(key, value)
                .map_err(|error| fail(format!("cannot set {key}: {error}")))?;
        }
        // Changing a key by hand takes it from the difficulty.
        scenario.difficulty = Some(difficulty);
        Ok(scenario)
    }
}

fn between(ends: &[toml::Value; 2], share: f64) -> Option<toml::Value> {
    use toml::Value::{Float, Integer};
    let number = |value: &toml::Value| match *value {
        Integer(whole) => Some(whole as f64),
        Float(number) => Some(number).filter(|number| number.is_finite()),
        _ => None,
    };
    let (low, high) = (number(&ends[0])?, number(&ends[1])?);
    let value = low + (high - low) * share;
    Some(match ends {
        [Integer(_), Integer(_)] => Integer(libm::round(value) as i64),
        _ => Float(value),
    })
}
