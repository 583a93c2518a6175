//! What an experiment is asked to be, checked field by field, and the command line that does the same.

use std::error::Error;
use std::fmt;

use crawler_sim::run::Simulation;
use crawler_sim::scenario::{NoThreshold, Scenario, Threshold};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::scenarios::{Change, ChangeError, Changes, NoScenario, Randomisation, built_in, quoted};

/// Longest name, in characters.
const MAX_NAME: usize = 64;
/// Most seeds.
const MAX_SEEDS: u32 = crawler_records::MAX_SEEDS;
/// Most robots of a world: what half of a gigabyte holds.
pub(super) const MAX_ROBOTS: u32 = 10_000;
/// Most keys that are set, and thresholds.
const MAX_SET: usize = 32;
const MAX_THRESHOLDS: usize = 16;
/// Longest word of a recipe, in bytes.
const MAX_WORD: usize = 256;
/// What a field has to be.
pub(super) const WHOLE: &str = "must be a whole number";
pub(super) const TEXT: &str = "must be a text";
pub(super) const YES_OR_NO: &str = "must be true or false";
/// What every reader of JSON can count to.
pub const MAX_SEED: u64 = (1 << 53) - 1;

/// A part of what was asked that is wrong, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldError {
    /// JSON pointer (RFC 6901) to it.
    pub pointer: String,
    /// What is wrong with it, for people.
    pub detail: String,
}

/// What was asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recipe {
    /// Name of a scenario that comes along.
    pub scenario: String,
    /// How many robots were asked for; otherwise the scenario says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robots: Option<u32>,
    /// How many there are in each world.
    pub in_each: u32,
    /// How many seeds, each of which makes a trial.
    pub seeds: u32,
    /// The first of them.
    pub first_seed: u64,
    /// From 0 to 1, or the name of a level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub difficulty: Option<String>,
    /// Name of a profile.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub randomisation: Option<String>,
    /// Other values for keys of the scenario, `KEY=VALUE`.
    pub set: Vec<String>,
    /// What all trials must come to together, beside what the scenario asks.
    pub thresholds: Vec<String>,
}

/// An experiment to be made.
#[derive(Debug)]
pub(super) struct Wanted {
    pub(super) name: String,
    pub(super) recipe: Recipe,
    pub(super) start: bool,
    scenario: Scenario,
}

/// The fields of a body, and what is wrong with them.
pub(super) struct Form {
    fields: Map<String, Value>,
    errors: Vec<FieldError>,
}

impl Form {
    pub(super) const fn new(fields: Map<String, Value>) -> Self {
        Self {
            fields,
            errors: Vec::new(),
        }
    }

    /// What is wrong with them; nothing else may be there.
    pub(super) fn end(mut self) -> Result<(), Vec<FieldError>> {
        self.refuse_others();
        if self.errors.is_empty() {
            Ok(())
        } else {
            Err(self.errors)
        }
    }

    fn refuse_others(&mut self) {
        for (field, _) in std::mem::take(&mut self.fields) {
            self.wrong(&field, "is unknown");
        }
    }

    /// A name for people.
    pub(super) fn name(&mut self) -> String {
        let name: String = self.need("name", TEXT).unwrap_or_default();
        let name = name.trim().to_owned();
        if !self.is_wrong("name") && (name.is_empty() || name.chars().count() > MAX_NAME) {
            self.wrong("name", format!("must have 1 to {MAX_NAME} characters"));
        } else if name.contains(char::is_control) {
            self.wrong("name", "has control characters");
        }
        name
    }

    pub(super) fn wrong(&mut self, field: &str, detail: impl Into<String>) {
        let name = field.replace('~', "~0").replace('/', "~1");
        self.errors.push(FieldError {
            pointer: format!("/{name}"),
            detail: detail.into(),
        });
    }

    /// The same for the entry of that number in a list.
    fn wrong_entry(&mut self, field: &str, number: usize, detail: impl Into<String>) {
        self.errors.push(FieldError {
            pointer: format!("/{field}/{number}"),
            detail: detail.into(),
        });
    }

    /// Whether something is wrong with that field.
    fn is_wrong(&self, field: &str) -> bool {
        let mut pointers = self.errors.iter().map(|error| error.pointer.as_str());
        pointers.any(|pointer| pointer.strip_prefix('/') == Some(field))
    }

    /// The field of that name; `null` is as good as nothing.
    pub(super) fn take<T: DeserializeOwned>(&mut self, field: &str, rule: &str) -> Option<T> {
        let value = self.fields.remove(field).filter(|value| !value.is_null())?;
        let read = serde_json::from_value(value).ok();
        if read.is_none() {
            self.wrong(field, rule);
        }
        read
    }

    /// The same for one that has to be there.
    fn need<T: DeserializeOwned>(&mut self, field: &str, rule: &str) -> Option<T> {
        if self.fields.get(field).is_none_or(Value::is_null) {
            self.wrong(field, "is missing");
            return None;
        }
        self.take(field, rule)
    }

    /// A number within bounds.
    pub(super) fn number(
        &mut self,
        field: &str,
        value: Option<u64>,
        least: u64,
        most: u64,
    ) -> Option<u64> {
        let value = value?;
        if (least..=most).contains(&value) {
            return Some(value);
        }
        self.wrong(field, format!("must be {least} to {most}, not {value}"));
        None
    }

    /// A list of words, none of them too long or with anything in it that does not show.
    fn words(&mut self, field: &str, most: usize) -> Vec<String> {
        let words: Vec<String> = self
            .take(field, "must be a list of texts")
            .unwrap_or_default();
        if words.len() > most {
            self.wrong(field, format!("has more than {most} entries"));
            return Vec::new();
        }
        let words: Vec<String> = words.iter().map(|word| word.trim().to_owned()).collect();
        if let Some(odd) = words.iter().position(|word| !is_word(word)) {
            let rule = format!("is longer than {MAX_WORD} bytes, or has control characters");
            self.wrong_entry(field, odd, rule);
            return Vec::new();
        }
        words
    }

    /// The scenario, with as many of the changes as it takes.
    fn scenario(&mut self, recipe: &Recipe) -> Option<Scenario> {
        if self.is_wrong("scenario") {
            return None;
        }
        let scenario = match built_in(&recipe.scenario) {
            Ok(scenario) => scenario,
            Err(why) => {
                self.wrong("scenario", why.to_string());
                return None;
            }
        };
        let (scenario, refused) = recipe.changes().apply_all(scenario);
        for (change, why) in refused {
            let why = why.to_string();
            let why = why.trim_end();
            match change {
                Change::Difficulty => self.wrong("difficulty", why),
                Change::Robots => self.wrong("robots", why),
                Change::Randomisation => self.wrong("randomisation", why),
                Change::Set(number) => {
                    let detail = format!("{}: {why}", recipe.set[number]);
                    self.wrong_entry("set", number, detail);
                }
                Change::All => self.wrong("scenario", why),
            }
        }
        if !(1..=MAX_ROBOTS).contains(&scenario.robots) {
            let rule = format!("must be 1 to {MAX_ROBOTS}, not {}", scenario.robots);
            self.wrong("robots", rule);
        }
        Some(scenario)
    }
}

fn is_word(word: &str) -> bool {
    word.len() <= MAX_WORD && !word.contains(char::is_control)
}

/// Reads what is wanted.
///
/// # Errors
/// Every field that is wrong, and how. No world is built.
pub(super) fn read(fields: Map<String, Value>) -> Result<Wanted, Vec<FieldError>> {
    let mut form = Form::new(fields);
    let name = form.name();
    let scenario: Option<String> = form.need("scenario", TEXT);
    let robots = form.take("robots", WHOLE);
    let robots = form.number("robots", robots, 1, MAX_ROBOTS.into());
    let seeds = form.need("seeds", WHOLE);
    let seeds = form
        .number("seeds", seeds, 1, MAX_SEEDS.into())
        .unwrap_or(1);
    let first_seed = form.take("first_seed", WHOLE);
    let first_seed = form.number("first_seed", first_seed, 0, MAX_SEED - seeds);
    let difficulty: Option<String> = form.take("difficulty", TEXT);
    let randomisation: Option<String> = form.take("randomisation", TEXT);
    let profile = randomisation.as_deref().and_then(Randomisation::by_name);
    if randomisation.is_some() && profile.is_none() {
        form.wrong("randomisation", "is none of none, mild, wild");
    }
    let set = form.words("set", MAX_SET);
    let thresholds = form.words("thresholds", MAX_THRESHOLDS);
    for (number, threshold) in thresholds.iter().enumerate() {
        if let Err(why) = threshold.parse::<Threshold>() {
            form.wrong_entry("thresholds", number, why.to_string());
        }
    }
    let start = form.take("start", YES_OR_NO).unwrap_or(true);
    form.refuse_others();

    let recipe = Recipe {
        scenario: scenario.unwrap_or_default(),
        robots: robots.map(|robots| robots as u32),
        in_each: 0,
        seeds: seeds as u32,
        first_seed: first_seed.unwrap_or(1),
        difficulty,
        randomisation,
        set,
        thresholds,
    };
    match form.scenario(&recipe) {
        Some(scenario) if form.errors.is_empty() => Ok(Wanted {
            name,
            recipe: Recipe {
                in_each: scenario.robots,
                ..recipe
            },
            start,
            scenario,
        }),
        _ => Err(form.errors),
    }
}

impl Wanted {
    /// Builds the world of the first seed, which takes a moment.
    ///
    /// # Errors
    /// What is in the way.
    pub(super) fn build(&self) -> Result<(), Vec<FieldError>> {
        let built = Simulation::lockstep(self.scenario.clone(), self.recipe.first_seed);
        built.map(drop).map_err(|error| {
            vec![FieldError {
                pointer: "/scenario".to_owned(),
                detail: error.to_string(),
            }]
        })
    }
}

/// Why a program cannot run what another one has taken.
#[derive(Debug)]
pub(super) enum RecipeError {
    /// It has no such scenario.
    Scenario(NoScenario),
    /// The scenario does not take a change.
    Change(ChangeError),
    /// It knows no such threshold.
    Threshold(NoThreshold),
}

impl From<NoScenario> for RecipeError {
    fn from(error: NoScenario) -> Self {
        Self::Scenario(error)
    }
}

impl From<ChangeError> for RecipeError {
    fn from(error: ChangeError) -> Self {
        Self::Change(error)
    }
}

impl From<NoThreshold> for RecipeError {
    fn from(error: NoThreshold) -> Self {
        Self::Threshold(error)
    }
}

impl fmt::Display for RecipeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scenario(error) => error.fmt(f),
            Self::Change(error) => error.fmt(f),
            Self::Threshold(error) => error.fmt(f),
        }
    }
}

impl Error for RecipeError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Scenario(error) => Some(error),
            Self::Change(error) => Some(error),
            Self::Threshold(error) => Some(error),
        }
    }
}

impl Recipe {
    fn changes(&self) -> Changes<'_> {
        let randomisation = self.randomisation.as_deref();
        Changes {
            robots: self.robots,
            randomisation: randomisation.and_then(Randomisation::by_name),
            difficulty: self.difficulty.as_deref(),
            set: &self.set,
        }
    }

    /// The scenario, and what was asked of all trials together beside what the scenario asks.
    ///
    /// # Errors
    /// Why this program cannot run it, which the one that took it could.
    pub(super) fn scenario(&self) -> Result<(Scenario, Vec<Threshold>), RecipeError> {
        let scenario = self.changes().apply(built_in(&self.scenario)?)?;
        let thresholds: Result<_, _> = self.thresholds.iter().map(|text| text.parse()).collect();
        Ok((scenario, thresholds?))
    }

    /// The command line that comes to the same numbers, as a shell takes it.
    #[must_use]
    pub fn command(&self) -> String {
        let words = self.changes().words(&self.scenario);
        let mut command = format!(
            "terracrawler evaluate{words} --seeds {} --seed {}",
            self.seeds, self.first_seed
        );
        for threshold in &self.thresholds {
            command.push_str(" --threshold ");
            command.push_str(&quoted(threshold));
        }
        command
    }
}

#[cfg(test)]
#[path = "recipe_tests.rs"]
mod tests;
