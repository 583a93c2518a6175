//! Scenarios from names and files, with what the command line changes about them.

use std::path::Path;

use clap::ValueEnum;
use crawler_sim::scenario::Scenario;
use crawler_sim::world::Profile;

use crate::text::read_text;

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
    pub(crate) const fn profile(self) -> Profile {
        match self {
            Self::None => Profile::None,
            Self::Mild => Profile::Mild,
            Self::Wild => Profile::Wild,
        }
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Mild => "mild",
            Self::Wild => "wild",
        }
    }
}

/// What robots that have a camera see with.
pub(crate) const DETECTOR: Option<&[u8]> = Some(crawler_detector::BLOB);

/// What the command line changes about a scenario.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Changes<'a> {
    pub(crate) robots: Option<u32>,
    pub(crate) randomisation: Option<Randomisation>,
    pub(crate) difficulty: Option<&'a str>,
    /// Values for keys, like `duration_s=7`.
    pub(crate) set: &'a [String],
}

impl Changes<'_> {
    /// The scenario with the changes, in this order: difficulty, robots, randomisation, keys.
    ///
    /// # Errors
    /// One line that names the option.
    pub(crate) fn apply(&self, mut scenario: Scenario) -> Result<Scenario, String> {
        let refuse = |what: &str, error: &dyn std::fmt::Display| format!("{what}: {error}");
        if let Some(difficulty) = self.difficulty {
            let changed = scenario.with_difficulty(difficulty);
            scenario = changed.map_err(|error| refuse("--difficulty", &error))?;
        }
        if let Some(robots) = self.robots {
            let changed = scenario.with_value("robots", &robots.to_string());
            scenario = changed.map_err(|error| refuse("--robots", &error))?;
        }
        if let Some(profile) = self.randomisation {
            let changed = scenario.with_value("randomisation", profile.name());
            scenario = changed.map_err(|error| refuse("--randomisation", &error))?;
        }
        for pair in self.set {
            let (key, value) = pair
                .split_once('=')
                .ok_or_else(|| format!("--set {pair}: not like key=value"))?;
            let changed = scenario.with_value(key.trim(), value.trim());
            scenario = changed.map_err(|error| refuse(&format!("--set {pair}"), &error))?;
        }
        scenario.validate().map_err(|error| error.to_string())?;
        Ok(scenario)
    }
}

/// A scenario by name, or from a file, where robots that have a camera see.
pub(crate) fn scenario(name: Option<&str>) -> Result<Scenario, String> {
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
