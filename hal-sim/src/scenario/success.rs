//! What counts as success, of one run and of many.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::timeline::LONGEST_S;
use super::{Metric, Quota, ScenarioError};

/// What a run must come to; everything stated must hold. Where nothing is stated, all goals must
/// be reached, and every robot must be alive and none stranded at the end.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Success {
    /// How many robots reach all of their goals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reach: Option<Quota>,
    /// By when, seconds since the beginning of the world. Otherwise by the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_s: Option<f32>,
    /// Most contacts for each robot, on average.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub collisions: Option<f32>,
    /// No robot touches anything while it drives forward faster than this, metres per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub impact_mps: Option<f32>,
    /// How many robots have power and work, without a fault, at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alive: Option<Quota>,
    /// Most robots that stand at the end although they were sent to a behaviour and nobody has ended
    /// it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stranded: Option<u32>,
    /// Least share of commands that end as completed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command_success: Option<f32>,
    /// Every command gets its final answer within this time, seconds, from when it was given or
    /// the link was back.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub answer_s: Option<f32>,
    /// Least distance between a robot's rim and anything else, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clearance_m: Option<f32>,
    /// Least way of each robot, on average, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<f32>,
    /// Every robot is back at work so long after each of its faults, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_s: Option<f32>,
    /// Least share of the time in which robots can take commands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uptime: Option<f32>,
    /// No wheel is driven later than this after `stop` or `estop` was answered and before the next
    /// command, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub still_s: Option<f32>,
    /// Most contacts for each robot and minute.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contacts_per_minute: Option<f32>,
    /// How much alike robots head at least, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<f32>,
    /// Most groups of robots.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clusters: Option<f32>,
    /// Least share of the robots in the largest group.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub largest_cluster: Option<f32>,
    /// Least distance between the middles of two robots, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pair_distance_m: Option<f32>,
    /// Least share of the free floor that has a robot near.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<f32>,
    /// How evenly robots are spread over the free floor at least, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evenness: Option<f32>,
    /// Fewest neighbours at the spacing of the lattice, for each robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lattice_degree: Option<f32>,
    /// How far neighbours in the lattice are from its spacing at most, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing_error_m: Option<f32>,
    /// How far robots are from the places of the shape that they form at most, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape_error_m: Option<f32>,
    /// From when on all that is stated of the swarm holds at the latest, seconds since the
    /// beginning of the world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settle_s: Option<f32>,
    /// Least share of the coloured things that robots have found with their cameras.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found: Option<f32>,
    /// Least share of the robots at a consensus that have one value at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub agreement: Option<f32>,
    /// Least share of the tasks at which a robot is at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub served: Option<f32>,
    /// Least share of the robots sent to follow that do so at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<f32>,
    /// The longest that a place of a patrol may be left alone, in the second half of the run, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub idle_s: Option<f32>,
}

impl Success {
    /// Whether nothing is stated.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// What is stated of how a swarm stands and moves.
    #[must_use]
    pub fn of_swarm(&self) -> Vec<Threshold> {
        let stated = [
            (Metric::Order, true, self.order),
            (Metric::Clusters, false, self.clusters),
            (Metric::LargestCluster, true, self.largest_cluster),
            (Metric::PairDistanceM, true, self.pair_distance_m),
            (Metric::Coverage, true, self.coverage),
            (Metric::Evenness, true, self.evenness),
            (Metric::LatticeDegree, true, self.lattice_degree),
            (Metric::SpacingErrorM, false, self.spacing_error_m),
            (Metric::ShapeErrorM, false, self.shape_error_m),
        ];
        let stated = stated.into_iter();
        stated
            .filter_map(|(metric, at_least, limit)| Some(limiting(metric, at_least, limit?)))
            .collect()
    }

    /// What is stated of other metrics that are missed where they cannot be measured.
    #[must_use]
    pub fn of_others(&self) -> Vec<Threshold> {
        let stated = [
            (Metric::ContactsPerMinute, false, self.contacts_per_minute),
            (Metric::SettleS, false, self.settle_s),
            (Metric::Found, true, self.found),
            (Metric::Agreement, true, self.agreement),
            (Metric::Served, true, self.served),
            (Metric::Following, true, self.following),
            (Metric::IdleS, false, self.idle_s),
        ];
        let stated = stated.into_iter();
        stated
            .filter_map(|(metric, at_least, limit)| Some(limiting(metric, at_least, limit?)))
            .collect()
    }

    pub(super) fn validate(&self) -> Result<(), ScenarioError> {
        for (key, quota) in [("reach", self.reach), ("alive", self.alive)] {
            if let Some(quota) = quota {
                quota.validate(&format!("success.{key}"))?;
            }
        }
        for (key, value, most) in [
            ("within_s", self.within_s, LONGEST_S),
            ("collisions", self.collisions, 1e6),
            ("impact_mps", self.impact_mps, 100.0),
            ("command_success", self.command_success, 1.0),
            ("answer_s", self.answer_s, LONGEST_S),
            ("clearance_m", self.clearance_m, 100.0),
            ("distance_m", self.distance_m, 1e6),
            ("recovery_s", self.recovery_s, LONGEST_S),
            ("uptime", self.uptime, 1.0),
            ("still_s", self.still_s, LONGEST_S),
            ("contacts_per_minute", self.contacts_per_minute, 1e6),
            ("order", self.order, 1.0),
            ("clusters", self.clusters, 1e6),
            ("largest_cluster", self.largest_cluster, 1.0),
            ("pair_distance_m", self.pair_distance_m, 1e3),
            ("coverage", self.coverage, 1.0),
            ("evenness", self.evenness, 1.0),
            ("lattice_degree", self.lattice_degree, 100.0),
            ("spacing_error_m", self.spacing_error_m, 100.0),
            ("shape_error_m", self.shape_error_m, 100.0),
            ("settle_s", self.settle_s, LONGEST_S),
            ("found", self.found, 1.0),
            ("agreement", self.agreement, 1.0),
            ("served", self.served, 1.0),
            ("following", self.following, 1.0),
            ("idle_s", self.idle_s, LONGEST_S),
        ] {
            let value = value.unwrap_or(0.0);
            if !(0.0..=most).contains(&value) {
                let rule = format!("must be 0 to {most}, not {value}");
                return Err(ScenarioError::value(format!("success.{key}"), rule));
            }
        }
        Ok(())
    }
}

fn limiting(metric: Metric, at_least: bool, limit: f32) -> Threshold {
    // A number of 32 bits is seldom exact, and four of five are 0.8 of them.
    let value = libm::round(f64::from(limit) * 1e6) * 1e-6;
    Threshold {
        metric,
        at_least,
        value: if at_least { value - 1e-9 } else { value + 1e-9 },
    }
}

/// What many runs together must come to, like `success >= 0.9`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Threshold {
    /// Of what: its mean over all runs that have it, or the share of them that succeed.
    pub metric: Metric,
    /// Whether it must be at least `value`; otherwise at most.
    pub at_least: bool,
    /// How much.
    pub value: f64,
}

impl Threshold {
    /// Whether a mean meets it; one that does not exist meets none.
    #[must_use]
    pub fn is_met(&self, mean: Option<f64>) -> bool {
        mean.is_some_and(|mean| {
            if self.at_least {
                mean >= self.value
            } else {
                mean <= self.value
            }
        })
    }
}

impl fmt::Display for Threshold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.at_least { ">=" } else { "<=" };
        write!(f, "{} {sign} {}", self.metric.name(), self.value)
    }
}

/// Why a text is no [`Threshold`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NoThreshold {
    /// This is not like one.
    Shape(String),
    /// There is no such metric.
    Metric(String),
    /// The number in this is none that can be met.
    Infinite(String),
}

impl fmt::Display for NoThreshold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape(text) => {
                write!(
                    f,
                    "`{text}` is not like `success >= 0.9` or `collisions <= 2`"
                )
            }
            Self::Metric(name) => {
                let known: Vec<_> = Metric::ALL.iter().map(|metric| metric.name()).collect();
                write!(f, "`{name}` is none of {}", known.join(", "))
            }
            Self::Infinite(text) => write!(f, "`{text}` needs a finite number"),
        }
    }
}

impl std::error::Error for NoThreshold {}

impl std::str::FromStr for Threshold {
    type Err = NoThreshold;

    fn from_str(text: &str) -> Result<Self, NoThreshold> {
        let shape = || NoThreshold::Shape(text.to_owned());
        let (at_least, (name, value)) = match (text.split_once(">="), text.split_once("<=")) {
            (Some(parts), None) => (true, parts),
            (None, Some(parts)) => (false, parts),
            _ => return Err(shape()),
        };
        let name = name.trim();
        let metric = Metric::by_name(name);
        let metric = metric.ok_or_else(|| NoThreshold::Metric(name.to_owned()))?;
        let value: f64 = value.trim().parse().map_err(|_| shape())?;
        if !value.is_finite() {
            return Err(NoThreshold::Infinite(text.to_owned()));
        }
        Ok(Self {
            metric,
            at_least,
            value,
        })
    }
}

impl TryFrom<String> for Threshold {
    type Error = NoThreshold;

    fn try_from(text: String) -> Result<Self, NoThreshold> {
        text.parse()
    }
}

impl From<Threshold> for String {
    fn from(threshold: Threshold) -> Self {
        threshold.to_string()
    }
}
