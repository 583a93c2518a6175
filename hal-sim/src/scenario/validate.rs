//! Checking every value of a scenario before anything is built of it.

use super::timeline::{LONGEST_S, MOST_ENTRIES, MOST_REPEATS, Times};
use super::{Scenario, ScenarioError};
use crate::world::{ARENA_SIDE_M, Arena, MAX_ROBOTS};

/// Most characters of what a scenario says about itself.
const LONGEST_ABOUT: usize = 200;

/// The error of a key of a table, whose text begins with the key.
pub(super) fn named(table: &str, text: &str) -> ScenarioError {
    let (key, rule) = text.split_once(' ').unwrap_or(("", text));
    ScenarioError::value(format!("{table}.{key}"), rule)
}

impl Scenario {
    /// Checks every value.
    ///
    /// # Errors
    /// The first thing found wrong.
    pub fn validate(&self) -> Result<(), ScenarioError> {
        if self.name.is_empty() || self.name.len() > 64 {
            return Err(ScenarioError::value("name", "must have 1 to 64 bytes"));
        }
        let told = self.about.chars();
        if told.clone().count() > LONGEST_ABOUT || told.clone().any(char::is_control) {
            let rule = format!("must be one line of at most {LONGEST_ABOUT} characters");
            return Err(ScenarioError::value("about", rule));
        }
        if self.robots as usize > MAX_ROBOTS {
            let rule = format!("must be at most {MAX_ROBOTS}, not {}", self.robots);
            return Err(ScenarioError::value("robots", rule));
        }
        check("duration_s", self.duration_s, 0.1, LONGEST_S)?;
        self.validate_radio()?;
        self.tracker
            .validate()
            .map_err(|text| named("tracker", text))?;
        self.parameters.validate().map_err(|error| {
            let text = error.to_string();
            // The name goes first in either.
            let rule = text.strip_prefix(error.name).unwrap_or(&text).trim_start();
            ScenarioError::value(format!("parameters.{}", error.name), rule)
        })?;
        self.validate_bodies()?;
        self.action()?;
        let arena = self.validate_ground()?;
        check("spawn.clearance", self.spawn.clearance, 0.0, 10.0)?;
        let pulse_share = self.spawn.pulse_share.unwrap_or(0.0);
        check("spawn.pulse_share", pulse_share, 0.0, 1.0)?;
        check("spawn.camera_share", self.spawn.camera_share, 0.0, 1.0)?;
        self.validate_spawn(&arena)?;
        self.validate_timeline(&arena)?;
        self.success.validate()?;
        self.measure
            .validate()
            .map_err(|(key, rule)| ScenarioError::value(format!("measure.{key}"), rule))?;
        if self.thresholds.len() > MOST_ENTRIES {
            let rule = format!("must be at most {MOST_ENTRIES}");
            return Err(ScenarioError::value("thresholds", rule));
        }
        if let Some(difficulty) = &self.difficulty {
            difficulty.number()?;
        }
        Ok(())
    }

    fn validate_ground(&self) -> Result<Arena, ScenarioError> {
        let ground = &self.arena;
        if ground.width.is_some() != ground.height.is_some() {
            let rule = "is there without the other: give both arena.width and arena.height";
            let key = if ground.width.is_some() {
                "arena.width"
            } else {
                "arena.height"
            };
            return Err(ScenarioError::value(key, rule));
        }
        let (least, most) = (*ARENA_SIDE_M.start(), *ARENA_SIDE_M.end());
        for (key, value) in [
            ("arena.width", ground.width),
            ("arena.height", ground.height),
            ("arena.least_side", Some(ground.least_side)),
        ] {
            check(key, value.unwrap_or(least), least, most)?;
        }
        check("arena.area_per_robot", ground.area_per_robot, 0.1, 10_000.0)?;
        let scatter = &ground.scatter;
        let density = scatter.per_square_metre;
        check("arena.scatter.per_square_metre", density, 0.0, 4.0)?;
        check("arena.scatter.clearance", scatter.clearance, 0.0, 10.0)?;
        for (key, [low, high]) in [
            ("arena.scatter.radius", scatter.radius),
            ("arena.scatter.side", scatter.side),
        ] {
            check(key, low, 0.01, high)?;
            check(key, high, low, 5.0)?;
        }
        if let Some(generate) = &ground.generate {
            let sound = generate.validate(self.parameters.chassis.radius_m);
            sound.map_err(|(key, rule)| {
                ScenarioError::value(format!("arena.generate.{key}"), rule)
            })?;
        }
        let arena = self.fixed_arena();
        if !(least..=most).contains(&arena.width) {
            let rule = format!(
                "asks for a side of {}, which must be {least} to {most}",
                arena.width
            );
            return Err(ScenarioError::value("arena.area_per_robot", rule));
        }
        arena.validate()?;
        Ok(arena)
    }

    fn validate_timeline(&self, arena: &Arena) -> Result<(), ScenarioError> {
        for (key, entries) in [
            ("goals", self.goals.len()),
            ("commands", self.commands.len()),
            ("faults", self.faults.len()),
        ] {
            if entries > MOST_ENTRIES {
                let rule = format!("must be at most {MOST_ENTRIES}, not {entries}");
                return Err(ScenarioError::value(key, rule));
            }
        }
        let half = [arena.width * 0.5, arena.height * 0.5];
        for (index, goal) in self.goals.iter().enumerate() {
            let key = format!("goals[{index}]");
            self.check_robots(&key, &goal.robots)?;
            goal.validate(half).map_err(|(part, rule)| {
                let dot = if part.is_empty() { "" } else { "." };
                ScenarioError::value(format!("{key}{dot}{part}"), rule)
            })?;
        }
        for (index, timed) in self.commands.iter().enumerate() {
            let key = format!("commands[{index}]");
            self.check_robots(&key, &timed.robots)?;
            self.check_times(&key, timed.times())?;
            timed.action().map_err(|refused| {
                ScenarioError::value(format!("{key}.{}", refused.key), refused.rule)
            })?;
        }
        for (index, timed) in self.faults.iter().enumerate() {
            let key = format!("faults[{index}]");
            self.check_robots(&key, &timed.robots)?;
            self.check_times(&key, timed.times())?;
            let lasting = timed.for_s.unwrap_or(1.0);
            check(&format!("{key}.for_s"), lasting, 0.01, LONGEST_S)?;
            timed
                .fault
                .validate()
                .map_err(|error| ScenarioError::value(format!("{key}.fault"), error.to_string()))?;
        }
        Ok(())
    }

    fn validate_bodies(&self) -> Result<(), ScenarioError> {
        if self.bodies.len() > MOST_ENTRIES {
            let rule = format!("must be at most {MOST_ENTRIES}");
            return Err(ScenarioError::value("bodies", rule));
        }
        for (index, known) in self.bodies.iter().enumerate() {
            let key = format!("bodies[{index}]");
            self.check_robots(&key, &known.robots)?;
            known.body().validate().map_err(|error| {
                let rule = format!("must be between {} and {}", error.least, error.most);
                ScenarioError::value(format!("{key}.{}", error.name), rule)
            })?;
        }
        Ok(())
    }

    fn check_robots(&self, key: &str, robots: &super::Selector) -> Result<(), ScenarioError> {
        robots.validate(&format!("{key}.robots"), self.robots)
    }

    fn check_times(&self, key: &str, times: Times) -> Result<(), ScenarioError> {
        times
            .validate()
            .map_err(|(part, rule)| ScenarioError::value(format!("{key}.{part}"), rule))?;
        let end = times.until_s.unwrap_or(self.duration_s);
        let repeats = times
            .every_s
            .map_or(0.0, |every| (end - times.at_s) / every);
        if repeats > MOST_REPEATS {
            let rule = format!("makes it happen more than {MOST_REPEATS} times");
            return Err(ScenarioError::value(format!("{key}.every_s"), rule));
        }
        Ok(())
    }
}

fn check(key: &str, value: f32, low: f32, high: f32) -> Result<(), ScenarioError> {
    // Not-a-number is in no range.
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        let rule = format!("must be {low} to {high}, not {value}");
        Err(ScenarioError::value(key, rule))
    }
}
