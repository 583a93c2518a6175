//! Scenarios from names and files, with what the command line changes about them.

use std::error::Error;
use std::fmt;
use std::io;
use std::path::Path;

use clap::ValueEnum;
use crawler_sim::scenario::{Scenario, ScenarioError};
use crawler_sim::world::Profile;

use crawler_system::text::read_text;

/// Profiles of randomisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Randomisation {
    /// None
    None,
    /// As robots of one make in one room differ
    Mild,
    /// As far as a policy should still cope with
    Wild,
}

impl Randomisation {
    /// The profile as worlds take it.
    #[must_use]
    pub const fn profile(self) -> Profile {
        match self {
            Self::None => Profile::None,
            Self::Mild => Profile::Mild,
            Self::Wild => Profile::Wild,
        }
    }

    /// The profile of that name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        let all = [Self::None, Self::Mild, Self::Wild];
        all.into_iter().find(|profile| profile.name() == name)
    }

    /// Its name in files, bodies and options.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Mild => "mild",
            Self::Wild => "wild",
        }
    }
}

/// What robots that have a camera see with.
pub const DETECTOR: Option<&[u8]> = Some(crawler_detector::BLOB);

/// What the command line changes about a scenario.
#[derive(Debug, Clone, Copy)]
pub struct Changes<'a> {
    /// How many robots each world has.
    pub robots: Option<u32>,
    /// How far parameters differ from the scenario's.
    pub randomisation: Option<Randomisation>,
    /// From 0 to 1, or the name of a level.
    pub difficulty: Option<&'a str>,
    /// Values for keys, like `duration_s=7`.
    pub set: &'a [String],
}

/// One of the changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// Of how difficult it is.
    Difficulty,
    /// Of how many robots there are.
    Robots,
    /// Of how far parameters differ.
    Randomisation,
    /// The one of this number among those of `set`.
    Set(usize),
    /// All of them together.
    All,
}

/// Why a scenario cannot be what is asked of it.
#[derive(Debug, Clone)]
pub enum ChangeFault {
    /// What is to be set is no key with a value.
    NoPair,
    /// It would not be a sound one.
    Scenario(ScenarioError),
}

impl fmt::Display for ChangeFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPair => f.write_str("not like key=value"),
            Self::Scenario(error) => error.fmt(f),
        }
    }
}

impl Error for ChangeFault {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::NoPair => None,
            Self::Scenario(error) => Some(error),
        }
    }
}

/// The first change that a scenario does not take.
#[derive(Debug, Clone)]
pub struct ChangeError {
    /// The option that asks for it, as it was written; `None` where all changes together are at fault.
    pub option: Option<String>,
    /// Why not.
    pub why: ChangeFault,
}

impl fmt::Display for ChangeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.option {
            Some(option) => write!(f, "{option}: {}", self.why),
            None => self.why.fmt(f),
        }
    }
}

impl Error for ChangeError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        Some(&self.why)
    }
}

/// Why there is no such scenario.
#[derive(Debug)]
pub enum NoScenario {
    /// None of this name comes along, and a file is not meant.
    Unknown,
    /// None of this name comes along, nor can a file be read.
    Unreadable(String, io::Error),
    /// The file of this name holds none.
    File(String, ScenarioError),
    /// The one that comes along is not sound.
    BuiltIn(ScenarioError),
}

impl fmt::Display for NoScenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known = || Scenario::names().collect::<Vec<_>>().join(", ");
        match self {
            Self::Unknown => write!(f, "is none of {}", known()),
            Self::Unreadable(name, error) => write!(
                f,
                "`{name}` is neither a scenario ({}) nor a file that can be read: {error}",
                known()
            ),
            Self::File(name, error) => write!(f, "{name}: {}", error.to_string().trim_end()),
            Self::BuiltIn(error) => error.fmt(f),
        }
    }
}

impl Error for NoScenario {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Unknown => None,
            Self::Unreadable(_, error) => Some(error),
            Self::File(_, error) | Self::BuiltIn(error) => Some(error),
        }
    }
}

impl Changes<'_> {
    /// The scenario with the changes, in this order: difficulty, robots, randomisation, keys.
    ///
    /// # Errors
    /// One line that names the option.
    pub fn apply(&self, scenario: Scenario) -> Result<Scenario, ChangeError> {
        let (scenario, refused) = self.apply_all(scenario);
        let Some((change, why)) = refused.into_iter().next() else {
            return Ok(scenario);
        };
        let option = match change {
            Change::Difficulty => Some("--difficulty".to_owned()),
            Change::Robots => Some("--robots".to_owned()),
            Change::Randomisation => Some("--randomisation".to_owned()),
            Change::Set(number) => Some(format!("--set {}", self.set[number])),
            Change::All => None,
        };
        Err(ChangeError { option, why })
    }

    /// The same, and everything that is refused, with the reason; the scenario goes without that.
    #[must_use]
    pub fn apply_all(&self, scenario: Scenario) -> (Scenario, Vec<(Change, ChangeFault)>) {
        let mut refused = Vec::new();
        let mut scenario = scenario;
        let mut take = |change: Change, changed: Result<Scenario, ChangeFault>| match changed {
            Ok(changed) => Some(changed),
            Err(why) => {
                refused.push((change, why));
                None
            }
        };
        if let Some(difficulty) = self.difficulty {
            let changed = scenario.clone().with_difficulty(difficulty);
            let changed = changed.map_err(ChangeFault::Scenario);
            scenario = take(Change::Difficulty, changed).unwrap_or(scenario);
        }
        if let Some(robots) = self.robots {
            let changed = with(&scenario, "robots", &robots.to_string());
            scenario = take(Change::Robots, changed).unwrap_or(scenario);
        }
        if let Some(profile) = self.randomisation {
            let changed = with(&scenario, "randomisation", profile.name());
            scenario = take(Change::Randomisation, changed).unwrap_or(scenario);
        }
        for (number, pair) in self.set.iter().enumerate() {
            let changed = match pair.split_once('=') {
                Some((key, value)) => with(&scenario, key.trim(), value.trim()),
                None => Err(ChangeFault::NoPair),
            };
            scenario = take(Change::Set(number), changed).unwrap_or(scenario);
        }
        if refused.is_empty()
            && let Err(error) = scenario.validate()
        {
            refused.push((Change::All, ChangeFault::Scenario(error)));
        }
        (scenario, refused)
    }

    /// The options of the command line that make these changes of `scenario`, as a shell takes them,
    /// each after a space.
    #[must_use]
    pub fn words(&self, scenario: &str) -> String {
        let mut words = vec![String::new(), "--scenario".into(), quoted(scenario)];
        if let Some(robots) = self.robots {
            words.extend(["--robots".into(), robots.to_string()]);
        }
        if let Some(profile) = self.randomisation {
            words.extend(["--randomisation".into(), profile.name().into()]);
        }
        if let Some(difficulty) = self.difficulty {
            words.extend(["--difficulty".into(), quoted(difficulty)]);
        }
        for set in self.set {
            words.extend(["--set".into(), quoted(set)]);
        }
        words.join(" ")
    }
}

fn with(scenario: &Scenario, key: &str, value: &str) -> Result<Scenario, ChangeFault> {
    scenario
        .with_value(key, value)
        .map_err(ChangeFault::Scenario)
}

/// A word as a shell takes it.
#[must_use]
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// A scenario that comes along, where robots that have a camera see. Files are not looked at.
///
/// # Errors
/// One line with the names that there are.
pub fn built_in(name: &str) -> Result<Scenario, NoScenario> {
    let scenario = Scenario::built_in(name).map_err(|_| NoScenario::Unknown)?;
    Ok(Scenario {
        detector: DETECTOR,
        ..scenario
    })
}

/// A scenario by name, or from a file, where robots that have a camera see. The first that comes along when
/// there is no name.
///
/// # Errors
/// One line that says what is wrong with the name or the file.
pub fn scenario(name: Option<&str>) -> Result<Scenario, NoScenario> {
    Ok(Scenario {
        detector: DETECTOR,
        ..named(name)?
    })
}

fn named(name: Option<&str>) -> Result<Scenario, NoScenario> {
    let Some(name) = name else {
        let default = Scenario::names().next().unwrap_or("arena");
        return Scenario::built_in(default).map_err(NoScenario::BuiltIn);
    };
    if Scenario::names().any(|known| known == name) {
        return Scenario::built_in(name).map_err(NoScenario::BuiltIn);
    }
    let text = read_text(Path::new(name))
        .map_err(|error| NoScenario::Unreadable(name.to_owned(), error))?;
    Scenario::parse(&text).map_err(|error| NoScenario::File(name.to_owned(), error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scenario_that_comes_along_is_found_by_name() {
        for name in Scenario::names() {
            assert_eq!(scenario(Some(name)).expect(name).name, name);
        }
        assert!(scenario(None).is_ok());
    }

    #[test]
    fn a_scenario_that_is_not_there_is_named_with_those_that_are() {
        let error = scenario(Some("nowhere.toml")).expect_err("no such file");
        let error = error.to_string();
        assert!(error.contains("nowhere.toml"), "{error}");
        assert!(error.contains("arena"), "{error}");
    }
}
