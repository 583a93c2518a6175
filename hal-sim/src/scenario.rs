//! Recipes for worlds.
//!
//! A [`Scenario`] is a TOML file. Everything but its name has a default; an unknown key is an
//! error. What it leaves to chance is drawn from the seed of the run.

mod error;
mod spawn;
mod tracker;

use std::collections::BTreeMap;

use crawler_protocol::{Action, Command};
use rand_core::Rng;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use crate::net::lockstep::LinkModel;
use crate::world::{ARENA_SIDE_M, Arena, ArenaError, MAX_OBSTACLES, MAX_ROBOTS, Obstacle};
use crate::world::{Parameters, Wiring};

pub use error::ScenarioError;
pub use spawn::Spawner;
pub use tracker::Tracker;

use spawn::{Nearby, TRIES};

/// The scenarios that come with the crate: name and file.
const BUILT_IN: [(&str, &str); 3] = [
    ("arena", include_str!("../scenarios/arena.toml")),
    ("corridor", include_str!("../scenarios/corridor.toml")),
    ("empty", include_str!("../scenarios/empty.toml")),
];

/// A recipe for worlds, see the [module](self).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Name, for people.
    pub name: String,
    /// Number of robots, unless the run says otherwise.
    #[serde(default = "one")]
    pub robots: u32,
    /// The ground.
    #[serde(default)]
    pub arena: Ground,
    /// Where robots start.
    #[serde(default)]
    pub spawn: Spawn,
    /// What every robot is told once it can take commands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<Start>,
    /// Links, in lockstep runs.
    #[serde(default)]
    pub link: LinkModel,
    /// The camera above the arena.
    #[serde(default)]
    pub tracker: Tracker,
    /// Physical constants; `parameters.ranger.wiring` says how the rangers are wired.
    /// Where `spawn.pulse_share` is given, it decides instead.
    #[serde(default)]
    pub parameters: Parameters,
}

/// Size of the arena and what stands in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ground {
    /// Length along x, metres. Without it the arena is a square of `area_per_robot` for each
    /// robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<f32>,
    /// Length along y, metres; goes with `width`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<f32>,
    /// Square metres for each robot.
    pub area_per_robot: f32,
    /// Shortest side of a square arena, metres.
    pub least_side: f32,
    /// Obstacles at given places.
    pub obstacles: Vec<Obstacle>,
    /// Obstacles at places drawn from the seed.
    pub scatter: Scatter,
}

impl Default for Ground {
    fn default() -> Self {
        Self {
            width: None,
            height: None,
            area_per_robot: 2.0,
            least_side: 3.0,
            obstacles: Vec::new(),
            scatter: Scatter::default(),
        }
    }
}

/// Obstacles drawn from the seed: half of them circles, half boxes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scatter {
    /// Number for each square metre of the arena.
    pub per_square_metre: f32,
    /// Smallest and largest radius of circles, metres.
    pub radius: [f32; 2],
    /// Shortest and longest side of boxes, metres.
    pub side: [f32; 2],
    /// Free space around each, metres: a robot has to get through.
    pub clearance: f32,
}

impl Default for Scatter {
    fn default() -> Self {
        Self {
            per_square_metre: 0.0,
            radius: [0.08, 0.25],
            side: [0.15, 0.6],
            clearance: 0.45,
        }
    }
}

/// Where robots start: anywhere, looking anywhere.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spawn {
    /// Free space between a robot's rim and anything else, metres.
    pub clearance: f32,
    /// Share of robots whose ranger is wired for trigger and echo, 0 to 1; the others have a
    /// serial line. They take turns, so that any number of robots has this share as nearly as it
    /// can. Without it all are wired as `parameters.ranger.wiring` says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pulse_share: Option<f32>,
    /// Share of robots that have a camera, 0 to 1; they take turns too. A camera costs 16 KB of
    /// memory, and time only when it takes a picture.
    pub camera_share: f32,
}

impl Default for Spawn {
    fn default() -> Self {
        Self {
            clearance: 0.1,
            pulse_share: None,
            camera_share: 0.0,
        }
    }
}

/// A command without timestamp, sequence number and source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Name of the command.
    pub command: String,
    /// Its parameters.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, serde_json::Value>,
}

const fn one() -> u32 {
    1
}

impl Scenario {
    /// Names of the scenarios that come with the crate. The first is the default.
    pub fn names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|&(name, _)| name)
    }

    /// A scenario that comes with the crate.
    ///
    /// # Errors
    /// [`ScenarioError::Unknown`] when there is none of that name.
    pub fn built_in(name: &str) -> Result<Self, ScenarioError> {
        let (_, text) = BUILT_IN
            .iter()
            .find(|(known, _)| *known == name)
            .ok_or_else(|| ScenarioError::Unknown(name.to_owned()))?;
        Self::parse(text)
    }

    /// Reads a scenario.
    ///
    /// # Errors
    /// See [`ScenarioError`]; TOML errors name line and column.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        let scenario: Self =
            toml::from_str(text).map_err(|error| ScenarioError::Text(Box::new(error)))?;
        scenario.validate()?;
        Ok(scenario)
    }

    /// The same for another number of robots.
    #[must_use]
    pub fn with_robots(mut self, robots: u32) -> Self {
        self.robots = robots;
        self
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first thing found wrong.
    pub fn validate(&self) -> Result<(), ScenarioError> {
        let check = |key: &'static str, value: f32, low: f32, high: f32| {
            if (low..=high).contains(&value) {
                Ok(())
            } else {
                let rule = format!("must be {low} to {high}, not {value}");
                Err(ScenarioError::Value(key, rule))
            }
        };
        if self.name.is_empty() || self.name.len() > 64 {
            let rule = "must have 1 to 64 bytes".to_owned();
            return Err(ScenarioError::Value("name", rule));
        }
        if self.robots as usize > MAX_ROBOTS {
            let rule = format!("must be at most {MAX_ROBOTS}, not {}", self.robots);
            return Err(ScenarioError::Value("robots", rule));
        }
        let ground = &self.arena;
        if ground.width.is_some() != ground.height.is_some() {
            let rule = "must both be there, or neither".to_owned();
            return Err(ScenarioError::Value("arena.width and arena.height", rule));
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
        check(
            "arena.scatter.per_square_metre",
            scatter.per_square_metre,
            0.0,
            4.0,
        )?;
        check("arena.scatter.clearance", scatter.clearance, 0.0, 10.0)?;
        for (key, [low, high]) in [
            ("arena.scatter.radius", scatter.radius),
            ("arena.scatter.side", scatter.side),
        ] {
            check(key, low, 0.01, high)?;
            check(key, high, low, 5.0)?;
        }
        check("spawn.clearance", self.spawn.clearance, 0.0, 10.0)?;
        check(
            "spawn.pulse_share",
            self.spawn.pulse_share.unwrap_or(0.0),
            0.0,
            1.0,
        )?;
        check("spawn.camera_share", self.spawn.camera_share, 0.0, 1.0)?;
        self.link
            .validate()
            .map_err(|rule| ScenarioError::Value("link", rule.to_owned()))?;
        self.tracker
            .validate()
            .map_err(|rule| ScenarioError::Value("tracker", rule.to_owned()))?;
        self.parameters
            .validate()
            .map_err(|error| ScenarioError::Value("parameters", error.to_string()))?;
        self.action()?;
        let (width, height) = self.sides();
        check(
            "the side that arena.area_per_robot asks for",
            width,
            least,
            most,
        )?;
        let fixed = Arena {
            width,
            height,
            obstacles: ground.obstacles.clone(),
        };
        Ok(fixed.validate()?)
    }

    /// The initial command, when there is one.
    ///
    /// # Errors
    /// [`ScenarioError::Command`] when it is not a command.
    pub fn action(&self) -> Result<Option<Action>, ScenarioError> {
        let Some(start) = &self.command else {
            return Ok(None);
        };
        let mut object = serde_json::json!({
            "command": start.command,
            "timestamp": 0,
            "seq": 1,
            "source": "scenario",
        });
        if !start.parameters.is_empty() {
            object["parameters"] = serde_json::json!(start.parameters);
        }
        let command = Command::parse(object.to_string().as_bytes())
            .map_err(|error| ScenarioError::Command(error.reason.name().to_owned()))?;
        Ok(Some(command.action))
    }

    fn sides(&self) -> (f32, f32) {
        if let (Some(width), Some(height)) = (self.arena.width, self.arena.height) {
            return (width, height);
        }
        let area = self.arena.area_per_robot * self.robots.max(1) as f32;
        let side = area.sqrt().max(self.arena.least_side);
        (side, side)
    }

    /// The arena of a run, with the obstacles that `seed` puts into it.
    ///
    /// # Errors
    /// [`ScenarioError::NoRoom`] when an obstacle finds no place.
    pub fn arena(&self, seed: u64) -> Result<Arena, ScenarioError> {
        let (width, height) = self.sides();
        let mut arena = Arena {
            width,
            height,
            obstacles: self.arena.obstacles.clone(),
        };
        arena.validate()?;
        let scatter = &self.arena.scatter;
        let wanted = (scatter.per_square_metre * width * height) as usize;
        if arena.obstacles.len() + wanted > MAX_OBSTACLES {
            return Err(ArenaError::TooManyObstacles.into());
        }
        let mut rng = Pcg32::new(seed, 0x6F62_7374);
        let mut draw = |low: f32, high: f32| {
            low + (high - low) * ((rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0))
        };
        // Only what lies near can be in the way: with thousands of obstacles, looking at all of
        // them for each draw would take minutes.
        let mut near = Nearby::new(&arena, scatter.side[1].max(scatter.radius[1]) * 2.0);
        for number in 0..wanted {
            let mut placed = false;
            for _ in 0..TRIES {
                let (x, y) = (
                    draw(-width * 0.5, width * 0.5),
                    draw(-height * 0.5, height * 0.5),
                );
                let (obstacle, reach) = if number % 2 == 0 {
                    let r = draw(scatter.radius[0], scatter.radius[1]);
                    (Obstacle::Circle { x, y, r }, r)
                } else {
                    let w = draw(scatter.side[0], scatter.side[1]);
                    let h = draw(scatter.side[0], scatter.side[1]);
                    let theta = draw(0.0, core::f32::consts::PI);
                    let reach = (w * w + h * h).sqrt() * 0.5;
                    (Obstacle::Box { x, y, w, h, theta }, reach)
                };
                if near.clearance(&arena, x, y, reach + scatter.clearance)
                    >= reach + scatter.clearance
                {
                    near.add(arena.obstacles.len() as u32, x, y);
                    arena.obstacles.push(obstacle);
                    placed = true;
                    break;
                }
            }
            if !placed {
                return Err(ScenarioError::NoRoom(format!(
                    "obstacle {} of {wanted} in an arena of {width} m by {height} m",
                    number + 1
                )));
            }
        }
        arena.validate()?;
        Ok(arena)
    }

    /// How the ranger of robot number `number` is wired, counting from 0.
    #[must_use]
    pub fn wiring(&self, number: usize) -> Wiring {
        let Some(share) = self.spawn.pulse_share else {
            return self.parameters.ranger.wiring;
        };
        if has_turn(number, share) {
            Wiring::Pulse
        } else {
            Wiring::Uart
        }
    }

    /// Whether robot number `number` has a camera, counting from 0.
    #[must_use]
    pub fn has_camera(&self, number: usize) -> bool {
        has_turn(number, self.spawn.camera_share)
    }

    /// Draws starting poses. Whoever places a robot there checks that the place is free.
    #[must_use]
    pub fn spawner(&self, arena: &Arena, seed: u64) -> Spawner {
        Spawner {
            half_width: arena.width * 0.5,
            half_height: arena.height * 0.5,
            rng: Pcg32::new(seed, 0x7370_6177),
        }
    }
}

/// Whether number `number` is one of a share of all, when they take turns.
fn has_turn(number: usize, share: f32) -> bool {
    let among = |robots: usize| libm::round(robots as f64 * f64::from(share));
    among(number + 1) > among(number)
}

#[cfg(test)]
mod tests;
