//! What a training is asked to be, checked field by field, and the command line that does the same.

use std::error::Error;
use std::fmt;
use std::time::Duration;

use crawler_federated::Aggregation;
use crawler_federated::coordinator::MOST_NODES;
use crawler_learning::federated::FederatedOptions;
use crawler_learning::{Options, Spread};
use crawler_records::MAX_SEEDS;
use crawler_sim::scenario::{Scenario, ScenarioError};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::recipe::{FieldError, Form, MAX_SEED, TEXT, WHOLE, YES_OR_NO};
use crate::scenarios::Randomisation;

/// The algorithm that there is.
const ALGORITHM: &str = "ppo";
/// The task that there is.
const TASK: &str = "spread";
/// Most decisions to learn from.
const MAX_STEPS: u64 = 1_000_000_000;
/// Most worlds side by side: a round of so many takes seconds, and nobody waits longer for it to stand.
const MAX_WORLDS: u64 = 256;
/// Units of the hidden layers, as robots have room for.
const UNITS: std::ops::RangeInclusive<u64> = 4..=64;
/// Most rounds: the curve stays within a megabyte.
const MAX_ROUNDS: u64 = 10_000;
/// Longest time that nodes are waited for, in seconds.
const MAX_DEADLINE_S: u64 = 3_600;
const _: () = assert!(MAX_ROUNDS <= MAX_SEEDS as u64);

/// What was asked for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// Name of the algorithm.
    pub algorithm: String,
    /// Name of the task.
    pub task: String,
    /// Names the run.
    pub seed: u64,
    /// Decisions of all robots to learn from.
    pub steps: u64,
    /// Worlds side by side; where nodes learn, on each of them.
    pub worlds: u32,
    /// Units of both hidden layers.
    pub units: u32,
    /// Whether the critic sees no more than a robot.
    pub own_critic: bool,
    /// Name of a profile.
    pub randomisation: String,
    /// The nodes that learn, where the server does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nodes: Option<AskedNodes>,
}

/// How nodes are to learn together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = TrainingByNodes)]
pub struct AskedNodes {
    /// How many are expected.
    pub count: usize,
    /// So many have to answer a round.
    pub quorum: usize,
    /// How long the others are waited for, in seconds.
    pub deadline_s: u64,
    /// Name of a rule by which updates become one.
    pub aggregation: String,
    /// Part of the step before that is taken again.
    pub momentum: f32,
    /// How strongly each is pulled back to what all have.
    pub proximal: f32,
}

/// By what a training learns.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Means {
    /// By itself.
    Alone(Options),
    /// By nodes at the broker.
    Federated(FederatedOptions),
}

/// A training to be made.
#[derive(Debug)]
pub(crate) struct Wanted {
    pub(crate) name: String,
    pub(crate) asked: Asked,
    pub(crate) rounds: u32,
    pub(crate) start: bool,
}

/// Reads what is wanted.
///
/// # Errors
/// Every field that is wrong, and how.
pub(crate) fn read(fields: Map<String, Value>) -> Result<Wanted, Vec<FieldError>> {
    let mut form = Form::new(fields);
    let name = form.name();
    let nodes = nodes(&mut form);
    let usual = if nodes.is_some() {
        FederatedOptions::default().options
    } else {
        Options::default()
    };
    for (field, only) in [("algorithm", ALGORITHM), ("task", TASK)] {
        let named: Option<String> = form.take(field, TEXT);
        if named.is_some_and(|named| named != only) {
            form.wrong(field, format!("must be {only}: there is no other one"));
        }
    }
    let mut number = |field: &str, least: u64, most: u64, usual: u64| {
        let value = form.take(field, WHOLE);
        form.number(field, value, least, most).unwrap_or(usual)
    };
    let seed = number("seed", 0, MAX_SEED, usual.seed);
    let steps = number("steps", 1, MAX_STEPS, usual.steps);
    let worlds = number("worlds", 1, MAX_WORLDS, usual.worlds as u64);
    let units = number("units", *UNITS.start(), *UNITS.end(), usual.units as u64);
    let own_critic = form
        .take("own_critic", YES_OR_NO)
        .unwrap_or(!usual.privileged);
    let randomisation: Option<String> = form.take("randomisation", TEXT);
    let randomisation = randomisation.unwrap_or_else(|| Randomisation::None.name().to_owned());
    if Randomisation::by_name(&randomisation).is_none() {
        form.wrong("randomisation", "is none of none, mild, wild");
    }
    let start = form.take("start", YES_OR_NO).unwrap_or(true);
    let asked = Asked {
        algorithm: ALGORITHM.to_owned(),
        task: TASK.to_owned(),
        seed,
        steps,
        // Within their bounds, which are small.
        worlds: worlds as u32,
        units: units as u32,
        own_critic,
        randomisation,
        nodes,
    };
    let rounds = asked.rounds();
    if rounds > MAX_ROUNDS {
        let each = steps.div_ceil(rounds.max(1));
        form.wrong(
            "steps",
            format!("makes {rounds} rounds of about {each}, and {MAX_ROUNDS} is the most: ask for more worlds, or fewer steps"),
        );
    }
    form.end()?;
    Ok(Wanted {
        name,
        asked,
        rounds: rounds as u32,
        start,
    })
}

/// Fields of how nodes learn, beside their number.
const OF_NODES: [&str; 5] = [
    "quorum",
    "deadline_s",
    "aggregation",
    "momentum",
    "proximal",
];

/// Reads by which nodes it is to be learned, if by any.
fn nodes(form: &mut Form) -> Option<AskedNodes> {
    let Some(count) = form.take::<u64>("nodes", WHOLE) else {
        for field in OF_NODES {
            if form.take::<Value>(field, "").is_some() {
                form.wrong(field, "is of a training by nodes: say how many `nodes`");
            }
        }
        return None;
    };
    let usual = FederatedOptions::default();
    let count = form
        .number("nodes", Some(count), 1, MOST_NODES as u64)
        .unwrap_or(1);
    let quorum = form.take("quorum", WHOLE);
    let quorum = form.number("quorum", quorum, 1, count);
    let deadline = form.take("deadline_s", WHOLE);
    let deadline = form.number("deadline_s", deadline, 1, MAX_DEADLINE_S);
    let aggregation: Option<String> = form.take("aggregation", TEXT);
    if let Some(Err(error)) = aggregation.as_deref().map(str::parse::<Aggregation>) {
        form.wrong("aggregation", format!("must be {error}"));
    }
    let mut share = |field: &str, most: f32, usual: f32| {
        let number = form.take::<f32>(field, "must be a number");
        if number.is_some_and(|number| !(0.0..=most).contains(&number)) {
            form.wrong(field, format!("must be 0 to {most}"));
        }
        number.unwrap_or(usual)
    };
    Some(AskedNodes {
        // More than half, where nobody says.
        quorum: quorum.unwrap_or(count / 2 + 1) as usize,
        count: count as usize,
        deadline_s: deadline.unwrap_or(usual.deadline.as_secs()),
        momentum: share("momentum", 0.99, usual.momentum),
        proximal: share("proximal", 10.0, usual.proximal),
        aggregation: aggregation.unwrap_or_else(|| usual.aggregation.to_string()),
    })
}

/// Why a program cannot train what another one has taken.
#[derive(Debug)]
pub(super) enum Untrainable {
    /// It knows no such algorithm for this task.
    Task(String, String),
    /// It knows no such randomisation.
    Randomisation(String),
    /// It knows no such rule for updates.
    Aggregation(String),
    /// The scenario of the task is not sound.
    Scenario(ScenarioError),
}

impl fmt::Display for Untrainable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Task(algorithm, task) => write!(f, "it knows no {algorithm} for {task}"),
            Self::Randomisation(name) | Self::Aggregation(name) => {
                write!(f, "it knows no {name}")
            }
            Self::Scenario(error) => error.fmt(f),
        }
    }
}

impl Error for Untrainable {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Task(..) | Self::Randomisation(_) | Self::Aggregation(_) => None,
            Self::Scenario(error) => Some(error),
        }
    }
}

impl Asked {
    /// The same for the run.
    pub(super) const fn options(&self) -> Options {
        Options {
            seed: self.seed,
            steps: self.steps,
            worlds: self.worlds as usize,
            units: self.units as usize,
            privileged: !self.own_critic,
        }
    }

    /// By what it is learned.
    ///
    /// # Errors
    /// Why this program cannot train it, which the one that took it could.
    pub(super) fn means(&self) -> Result<Means, Untrainable> {
        let Some(nodes) = &self.nodes else {
            return Ok(Means::Alone(self.options()));
        };
        let unknown = |_| Untrainable::Aggregation(nodes.aggregation.clone());
        Ok(Means::Federated(FederatedOptions {
            options: self.options(),
            nodes: nodes.count,
            quorum: nodes.quorum,
            deadline: Duration::from_secs(nodes.deadline_s),
            aggregation: nodes.aggregation.parse().map_err(unknown)?,
            momentum: nodes.momentum,
            proximal: nodes.proximal,
        }))
    }

    /// The worlds to learn in; where nodes learn, those that the policy is judged in.
    ///
    /// # Errors
    /// Why this program cannot train it, which the one that took it could.
    pub(super) fn scenario(&self) -> Result<Scenario, Untrainable> {
        if self.algorithm != ALGORITHM || self.task != TASK {
            return Err(Untrainable::Task(self.algorithm.clone(), self.task.clone()));
        }
        let profile = Randomisation::by_name(&self.randomisation);
        let unknown = || Untrainable::Randomisation(self.randomisation.clone());
        let profile = profile.ok_or_else(unknown)?;
        let mut scenario = Spread::scenario().map_err(Untrainable::Scenario)?;
        scenario.randomisation = profile.profile();
        Ok(scenario)
    }

    /// Robots of each world.
    #[must_use]
    pub fn robots(&self) -> u32 {
        Spread::scenario().map_or(0, |scenario| scenario.robots)
    }

    fn rounds(&self) -> u64 {
        match self.means() {
            Ok(Means::Federated(together)) => together.rounds(self.robots()),
            Ok(Means::Alone(_)) | Err(_) => self.options().rounds(self.robots()),
        }
    }

    /// The command line that comes to the same bytes; of a training by nodes, the one that makes a node.
    #[must_use]
    pub fn command(&self) -> String {
        if self.nodes.is_some() {
            return "terracrawler learn-node --broker mqtt://HOST:1883 --name NAME".to_owned();
        }
        let Self {
            seed,
            steps,
            worlds,
            units,
            randomisation,
            ..
        } = self;
        let own_critic = if self.own_critic { " --own-critic" } else { "" };
        format!(
            "terracrawler train --out trained --seed {seed} --steps {steps} --worlds {worlds} --units {units} \
             --randomisation {randomisation}{own_critic}"
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn fields(value: Value) -> Map<String, Value> {
        match value {
            Value::Object(fields) => fields,
            _ => unreachable!("an object"),
        }
    }

    #[test]
    fn what_is_left_out_is_as_on_the_console() {
        let wanted = read(fields(json!({ "name": " first " }))).expect("fine");
        assert_eq!((wanted.name.as_str(), wanted.start), ("first", true));
        assert_eq!(wanted.asked.options(), Options::default());
        assert_eq!(wanted.rounds, 163);
        assert_eq!(wanted.asked.scenario().expect("there").robots, 3);
        assert_eq!(
            wanted.asked.command(),
            "terracrawler train --out trained --seed 1 --steps 4000000 --worlds 64 --units 64 --randomisation none"
        );
        let text = serde_json::to_string(&wanted.asked).expect("written");
        assert_eq!(
            serde_json::from_str::<Asked>(&text).expect("read"),
            wanted.asked
        );
    }

    #[test]
    fn every_field_that_is_wrong_is_named() {
        let body = json!({
            "name": "", "algorithm": "dqn", "task": 1, "seed": -1, "steps": 0, "worlds": 257, "units": 65,
            "own_critic": "no", "randomisation": "much", "start": 0, "a/b~": 1, "scenario": "spread",
        });
        let errors = read(fields(body)).expect_err("all of it");
        let mut pointers: Vec<&str> = errors.iter().map(|error| error.pointer.as_str()).collect();
        pointers.sort_unstable();
        assert_eq!(
            pointers,
            [
                "/algorithm",
                "/a~1b~0",
                "/name",
                "/own_critic",
                "/randomisation",
                "/scenario",
                "/seed",
                "/start",
                "/steps",
                "/task",
                "/units",
                "/worlds",
            ]
        );
        // A round of one world has 384 decisions.
        let body = |steps: u64| json!({ "name": "x", "worlds": 1, "steps": steps });
        assert_eq!(
            read(fields(body(3_840_000))).expect("just so").rounds,
            10_000
        );
        let errors = read(fields(body(3_840_001))).expect_err("one round too many");
        assert_eq!((errors.len(), errors[0].pointer.as_str()), (1, "/steps"));
    }

    #[test]
    fn nodes_are_asked_for_by_their_number() {
        let body = json!({ "name": "x", "nodes": 8, "aggregation": "median", "momentum": 0.5 });
        let wanted = read(fields(body)).expect("fine");
        let asked = wanted.asked.nodes.clone().expect("nodes");
        assert_eq!((asked.count, asked.quorum, asked.deadline_s), (8, 5, 60));
        assert_eq!(wanted.asked.worlds, 8);
        assert_eq!(wanted.rounds, 163);
        let Ok(Means::Federated(together)) = wanted.asked.means() else {
            unreachable!("nodes");
        };
        assert_eq!(together.aggregation, Aggregation::Median);
        together.settings(3).validate().expect("a run");
        let text = serde_json::to_string(&wanted.asked).expect("written");
        let again: Asked = serde_json::from_str(&text).expect("read");
        assert_eq!(again, wanted.asked);

        let body = json!({
            "name": "x", "nodes": 4, "quorum": 5, "deadline_s": 0, "aggregation": "most", "momentum": 1, "proximal": -1,
        });
        let errors = read(fields(body)).expect_err("all of it");
        let pointers: Vec<&str> = errors.iter().map(|error| error.pointer.as_str()).collect();
        assert_eq!(
            pointers,
            [
                "/quorum",
                "/deadline_s",
                "/aggregation",
                "/momentum",
                "/proximal"
            ]
        );
        for field in OF_NODES {
            let errors = read(fields(json!({ "name": "x", field: 1 }))).expect_err("without nodes");
            assert_eq!(errors[0].pointer, format!("/{field}"));
        }
        assert!(read(fields(json!({ "name": "x", "nodes": 65 }))).is_err());
    }

    proptest! {
        /// Whatever is asked, it is refused with pointers or can be trained.
        #[test]
        fn what_is_taken_can_be_trained(
            seed: u64, steps: u64, worlds in 0_u64..300, units in 0_u64..70,
            randomisation in "none|mild|wild|[a-z]{0,6}", name in "\\PC{0,70}",
        ) {
            let body = json!({
                "name": name, "seed": seed, "steps": steps, "worlds": worlds, "units": units,
                "randomisation": randomisation,
            });
            match read(fields(body)) {
                Ok(wanted) => {
                    prop_assert!((1..=MAX_ROUNDS).contains(&u64::from(wanted.rounds)));
                    prop_assert!(wanted.asked.scenario().is_ok());
                }
                Err(errors) => prop_assert!(errors.iter().all(|error| error.pointer.starts_with('/'))),
            }
        }
    }
}
