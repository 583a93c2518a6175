//! Scenarios from names and files, with what the command line changes about them.

use std::path::Path;

use clap::ValueEnum;
use crawler_sim::scenario::Scenario;
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

impl Changes<'_> {
    /// The scenario with the changes, in this order: difficulty, robots, randomisation, keys.
    ///
    /// # Errors
    /// One line that names the option.
    pub fn apply(&self, scenario: Scenario) -> Result<Scenario, String> {
        let (scenario, refused) = self.apply_all(scenario);
        let Some((change, why)) = refused.into_iter().next() else {
            return Ok(scenario);
        };
        Err(match change {
            Change::Difficulty => format!("--difficulty: {why}"),
            Change::Robots => format!("--robots: {why}"),
            Change::Randomisation => format!("--randomisation: {why}"),
            Change::Set(number) => format!("--set {}: {why}", self.set[number]),
            Change::All => why,
        })
    }

    /// The same, and everything that is refused, with the reason; the scenario goes without that.
    #[must_use]
    pub fn apply_all(&self, scenario: Scenario) -> (Scenario, Vec<(Change, String)>) {
        let mut refused = Vec::new();
        let mut scenario = scenario;
        let mut take = |change: Change, changed: Result<Scenario, String>| match changed {
            Ok(changed) => Some(changed),
            Err(why) => {
                refused.push((change, why));
                None
            }
        };
        if let Some(difficulty) = self.difficulty {
            let changed = scenario.clone().with_difficulty(difficulty);
            let changed = changed.map_err(|error| error.to_string());
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
                None => Err("not like key=value".to_owned()),
            };
            scenario = take(Change::Set(number), changed).unwrap_or(scenario);
        }
        if refused.is_empty()
            && let Err(error) = scenario.validate()
        {
            refused.push((Change::All, error.to_string()));
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

fn with(scenario: &Scenario, key: &str, value: &str) -> Result<Scenario, String> {
    let changed = scenario.with_value(key, value);
    changed.map_err(|error| error.to_string())
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
pub fn built_in(name: &str) -> Result<Scenario, String> {
    let scenario = Scenario::built_in(name).map_err(|_| {
        let known: Vec<_> = Scenario::names().collect();
        format!("is none of {}", known.join(", "))
    })?;
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
pub fn scenario(name: Option<&str>) -> Result<Scenario, String> {
    Ok(Scenario {
        detector: DETECTOR,
        ..named(name)?
    })
}

fn named(name: Option<&str>) -> Result<Scenario, String> {
    let Some(name) = name else {
        let default = Scenario::names().next().unwrap_or("arena");
        return Scenario::built_in(default).map_err(|error| error.to_string());
    };
    if Scenario::names().any(|known| known == name) {
        return Scenario::built_in(name).map_err(|error| error.to_string());
    }
    let text = read_text(Path::new(name)).map_err(|error| {
        let known: Vec<_> = Scenario::names().collect();
        format!(
            "`{name}` is neither a scenario ({}) nor a file that can be read: {error}",
            known.join(", ")
        )
    })?;
    Scenario::parse(&text).map_err(|error| format!("{name}: {}", error.to_string().trim_end()))
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
        assert!(error.contains("nowhere.toml"), "{error}");
        assert!(error.contains("arena"), "{error}");
    }
}
