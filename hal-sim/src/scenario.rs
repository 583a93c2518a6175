//! Recipes for worlds.
//!
//! A [`Scenario`] is a TOML file. Everything but its name has a default; an unknown key is an
//! error. What it leaves to chance is drawn from the seed of the run. `docs/scenarios.md` shows
//! every key.

mod bodies;
mod command;
mod difficulty;
mod edit;
mod error;
mod generate;
mod ground;
mod measure;
mod metric;
mod passable;
mod place;
mod preview;
mod radio;
mod select;
mod spawn;
mod success;
mod timeline;
mod tracker;
mod validate;

use std::collections::BTreeMap;
use std::sync::Arc;

use crawler_app::policy::{Named, Policy, SPREAD};
use crawler_protocol::{Action, PolicyName};
use serde::{Deserialize, Serialize};

use crate::net::lockstep::LinkModel;
use crate::net::radio::Radio;
use crate::world::{Body, Parameters, Profile, Wiring};

pub use bodies::KnownBody;
pub use command::Refused;
pub use difficulty::Difficulty;
pub use error::{ScenarioError, UnusablePolicy};
pub use generate::{Generate, Layout};
pub use ground::{Ground, Scatter};
pub use measure::Measure;
pub use metric::{Better, Metric};
pub use passable::Passable;
pub use place::Place;
pub use preview::Preview;
pub use select::{Quota, Selector};
pub use spawn::{Line, Spawn, SpawnPose, Spawner, Zone};
pub use success::{NoThreshold, Success, Threshold};
pub use timeline::{Draw, Goal, LONGEST_S, MOST_ENTRIES, TimedCommand, TimedFault};
pub use tracker::Tracker;

pub(crate) use passable::apart;
pub(crate) use timeline::Times;

/// The scenarios that come with the crate: name and file.
const BUILT_IN: [(&str, &str); 31] = [
    ("arena", include_str!("../scenarios/arena.toml")),
    ("corridor", include_str!("../scenarios/corridor.toml")),
    ("empty", include_str!("../scenarios/empty.toml")),
    ("search", include_str!("../scenarios/search.toml")),
    (
        "simple-navigation",
        include_str!("../scenarios/simple-navigation.toml"),
    ),
    (
        "dynamic-environment",
        include_str!("../scenarios/dynamic-environment.toml"),
    ),
    (
        "multi-robot-coordination",
        include_str!("../scenarios/multi-robot-coordination.toml"),
    ),
    ("resilience", include_str!("../scenarios/resilience.toml")),
    (
        "long-duration",
        include_str!("../scenarios/long-duration.toml"),
    ),
    ("maze", include_str!("../scenarios/maze.toml")),
    ("rooms", include_str!("../scenarios/rooms.toml")),
    ("u-trap", include_str!("../scenarios/u-trap.toml")),
    ("head-on", include_str!("../scenarios/head-on.toml")),
    ("doorway", include_str!("../scenarios/doorway.toml")),
    ("warehouse", include_str!("../scenarios/warehouse.toml")),
    (
        "long-corridor",
        include_str!("../scenarios/long-corridor.toml"),
    ),
    ("find", include_str!("../scenarios/find.toml")),
    ("crowd", include_str!("../scenarios/crowd.toml")),
    ("gather", include_str!("../scenarios/gather.toml")),
    ("disperse", include_str!("../scenarios/disperse.toml")),
    ("spread", include_str!("../scenarios/spread.toml")),
    ("flock", include_str!("../scenarios/flock.toml")),
    ("formation", include_str!("../scenarios/formation.toml")),
    ("follow", include_str!("../scenarios/follow.toml")),
    ("patrol", include_str!("../scenarios/patrol.toml")),
    ("consensus", include_str!("../scenarios/consensus.toml")),
    ("allocate", include_str!("../scenarios/allocate.toml")),
    ("cover", include_str!("../scenarios/cover.toml")),
    ("line", include_str!("../scenarios/line.toml")),
    ("wedge", include_str!("../scenarios/wedge.toml")),
    ("circle", include_str!("../scenarios/circle.toml")),
];

/// A recipe for worlds, see the [module](self).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Name, for people.
    pub name: String,
    /// What it is, in one sentence.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// Number of robots, unless the run says otherwise.
    #[serde(default = "one")]
    pub robots: u32,
    /// How long an evaluated run lasts, seconds.
    #[serde(default = "two_minutes")]
    pub duration_s: f32,
    /// Whether it ends before that once its timeline is over and every goal was reached.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub ends_early: bool,
    /// The ground.
    #[serde(default)]
    pub arena: Ground,
    /// Where robots start.
    #[serde(default)]
    pub spawn: Spawn,
    /// What every robot is told once it can take commands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<Start>,
    /// What robots are told later.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub commands: Vec<TimedCommand>,
    /// Where robots are to go.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub goals: Vec<Goal>,
    /// What breaks.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<TimedFault>,
    /// What an evaluated run must come to.
    #[serde(default, skip_serializing_if = "Success::is_empty")]
    pub success: Success,
    /// What evaluated runs must come to together.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub thresholds: Vec<Threshold>,
    /// By what a swarm is measured.
    #[serde(default, skip_serializing_if = "Measure::is_usual")]
    pub measure: Measure,
    /// How hard it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub difficulty: Option<Difficulty>,
    /// Links beyond the air. Where it is given, it takes the place of what
    /// `parameters.radio` says of them, and randomisation leaves it alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkModel>,
    /// Access points and partitions; without it robots are heard everywhere and the air costs
    /// nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radio: Option<Radio>,
    /// The camera above the arena.
    #[serde(default)]
    pub tracker: Tracker,
    /// Physical constants; `parameters.ranger.wiring` says how the rangers are wired.
    /// Where `spawn.pulse_share` is given, it decides instead.
    #[serde(default)]
    pub parameters: Parameters,
    /// Robots whose bodies are known, where those of others are drawn from `parameters.spread`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bodies: Vec<KnownBody>,
    /// How far the parameters of a run differ from these, drawn from its seed.
    #[serde(default)]
    pub randomisation: Profile,
    /// The model with which robots that have a camera see, a blob as `crawler_app::vision::Detector`
    /// reads it. Whoever runs the scenario gives it; no file does.
    #[serde(skip)]
    pub detector: Option<&'static [u8]>,
    /// The policy that robots can drive by in place of the one that comes with their program. Whoever runs the scenario
    /// gives it; no file does.
    #[serde(skip)]
    pub policy: Option<Trained>,
}

/// A policy, and what it is called.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trained {
    /// Its name, as `behave` gives it.
    pub name: PolicyName,
    /// A blob as `crawler_app::policy::Policy` reads it.
    pub blob: Arc<[u8]>,
}

impl Trained {
    /// The policy in `blob` under this name.
    ///
    /// # Errors
    /// [`UnusablePolicy`]
    pub fn new(name: &str, blob: Vec<u8>) -> Result<Self, UnusablePolicy> {
        let name = PolicyName::new(name).map_err(UnusablePolicy::Name)?;
        Policy::new(&blob).map_err(UnusablePolicy::Blob)?;
        let blob = blob.into();
        Ok(Self { name, blob })
    }

    /// The policy of this name that comes with the robot program.
    #[must_use]
    pub fn shipped(name: &str) -> Option<Self> {
        (name == SPREAD.name).then(|| Self::new(name, SPREAD.blob.to_vec()).ok())?
    }

    /// The same as robots take it.
    #[must_use]
    pub fn named(&self) -> Named<'_> {
        Named {
            name: self.name.as_str(),
            blob: &self.blob,
        }
    }

    /// The checksum that its blob has, to tell it from others.
    #[must_use]
    pub fn checksum(&self) -> String {
        let sum = self.blob.get(8..12).and_then(|sum| sum.try_into().ok());
        format!("{:08x}", u32::from_le_bytes(sum.unwrap_or_default()))
    }
}

/// Longest text of a scenario, bytes.
const LONGEST_TEXT: usize = 16 << 20;

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

const fn two_minutes() -> f32 {
    120.0
}

const fn yes() -> bool {
    true
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_yes(value: &bool) -> bool {
    *value
}

impl Start {
    /// The command itself.
    ///
    /// # Errors
    /// [`Refused`] when it is none.
    pub fn action(&self) -> Result<Action, Refused> {
        command::action(&self.command, &self.parameters)
    }
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

    /// Reads a scenario, and puts the values in that its difficulty asks for.
    ///
    /// # Errors
    /// See [`ScenarioError`]; line and column are named wherever there are some.
    pub fn parse(text: &str) -> Result<Self, ScenarioError> {
        if text.len() > LONGEST_TEXT {
            let why = format!("longer than {LONGEST_TEXT} bytes");
            return Err(ScenarioError::Text(why, None));
        }
        let scenario: Self =
            toml::from_str(text).map_err(|error| ScenarioError::of_text(&error, text))?;
        let sound = scenario.at_its_difficulty().and_then(|scenario| {
            scenario.validate()?;
            Ok(scenario)
        });
        sound.map_err(|error| error.located(text))
    }

    /// A scenario of this name and nothing else.
    #[must_use]
    pub fn plain(name: String) -> Self {
        Self {
            name,
            about: String::new(),
            robots: one(),
            duration_s: two_minutes(),
            ends_early: yes(),
            arena: Ground::default(),
            spawn: Spawn::default(),
            command: None,
            commands: Vec::new(),
            goals: Vec::new(),
            faults: Vec::new(),
            success: Success::default(),
            thresholds: Vec::new(),
            measure: Measure::default(),
            difficulty: None,
            link: None,
            radio: None,
            tracker: Tracker::default(),
            parameters: Parameters::default(),
            bodies: Vec::new(),
            randomisation: Profile::None,
            detector: None,
            policy: None,
        }
    }

    /// The same for another number of robots.
    #[must_use]
    pub fn with_robots(mut self, robots: u32) -> Self {
        self.robots = robots;
        self
    }

    /// The parameters of a run: as stated, or as randomisation draws them. Robots are configured
    /// as stated, and do not know.
    #[must_use]
    pub fn drawn_parameters(&self, seed: u64) -> Parameters {
        self.parameters.randomised(self.randomisation, seed)
    }

    /// The same for robots that drive by this policy from the beginning on.
    #[must_use]
    pub fn driven_by(mut self, policy: Trained) -> Self {
        let behave = [
            ("behaviour".to_owned(), serde_json::json!("policy")),
            ("policy".to_owned(), serde_json::json!(policy.name.as_str())),
        ];
        self.command = Some(Start {
            command: "behave".to_owned(),
            parameters: behave.into_iter().collect(),
        });
        self.policy = Some(policy);
        self
    }

    /// The initial command, when there is one.
    ///
    /// # Errors
    /// [`ScenarioError::Value`] when it is not a command.
    pub fn action(&self) -> Result<Option<Action>, ScenarioError> {
        let Some(start) = &self.command else {
            return Ok(None);
        };
        let action = start.action();
        Ok(Some(action.map_err(|refused| {
            ScenarioError::value(format!("command.{}", refused.key), refused.rule)
        })?))
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

    /// What is known of the body of robot number `number`, counting from 0; nothing where nobody names it.
    #[must_use]
    pub fn body(&self, number: usize) -> Body {
        let known = self.bodies.iter().rfind(|known| known.robots.has(number));
        known.map(KnownBody::body).unwrap_or_default()
    }

    /// Whether robot number `number` has a camera, counting from 0.
    #[must_use]
    pub fn has_camera(&self, number: usize) -> bool {
        has_turn(number, self.spawn.camera_share)
    }
}

/// Whether number `number` is one of a share of all, when they take turns.
fn has_turn(number: usize, share: f32) -> bool {
    let among = |robots: usize| libm::round(robots as f64 * f64::from(share));
    among(number + 1) > among(number)
}

#[cfg(test)]
mod tests;
