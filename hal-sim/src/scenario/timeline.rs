//! What happens when: commands, faults, and the places robots are sent to.

use std::collections::BTreeMap;
use std::fmt;

use crawler_protocol::Action;
use serde::{Deserialize, Serialize};

use super::Selector;
use super::command::{self, Refused};
use crate::faults::Fault;

/// Latest moment of anything in a scenario, seconds: four weeks.
pub const LONGEST_S: f32 = 2_419_200.0;
/// Most entries of a list in a scenario.
pub const MOST_ENTRIES: usize = 10_000;
/// Most times one entry may happen.
pub(super) const MOST_REPEATS: f32 = 100_000.0;

/// When an entry of a timeline happens, in seconds since the beginning of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::struct_field_names)] // the keys of a scenario file, which name their unit
pub(crate) struct Times {
    pub(crate) at_s: f32,
    pub(crate) every_s: Option<f32>,
    pub(crate) until_s: Option<f32>,
}

impl Times {
    /// The first value out of range: its key, and the rule.
    pub(super) fn validate(self) -> Result<(), (&'static str, String)> {
        let within = |key, value: f32, low: f32| {
            if (low..=LONGEST_S).contains(&value) {
                Ok(())
            } else {
                Err((key, format!("must be {low} to {LONGEST_S}, not {value}")))
            }
        };
        within("at_s", self.at_s, 0.0)?;
        match (self.every_s, self.until_s) {
            (None, None) => Ok(()),
            (None, Some(_)) => Err(("until_s", "needs every_s".to_owned())),
            (Some(every), until) => {
                within("every_s", every, 0.1)?;
                let until = until.unwrap_or(LONGEST_S);
                within("until_s", until, self.at_s)
            }
        }
    }
}

/// A command at a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedCommand {
    /// When, in seconds since the beginning of the world. Robots take motion commands once they
    /// know the time, about five seconds after their boot.
    pub at_s: f32,
    /// Again so often, seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub every_s: Option<f32>,
    /// Until then, seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f32>,
    /// Who.
    #[serde(default)]
    pub robots: Selector,
    /// Name of the command.
    pub command: String,
    /// Its parameters.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, serde_json::Value>,
}

impl TimedCommand {
    pub(crate) const fn times(&self) -> Times {
        Times {
            at_s: self.at_s,
            every_s: self.every_s,
            until_s: self.until_s,
        }
    }

    /// The command itself.
    ///
    /// # Errors
    /// [`Refused`] when it is none.
    pub fn action(&self) -> Result<Action, Refused> {
        command::action(&self.command, &self.parameters)
    }
}

/// Something broken at a time. The keys of the fault stand beside those below.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "FaultText", into = "FaultText")]
pub struct TimedFault {
    /// When, in seconds since the beginning of the world.
    pub at_s: f32,
    /// For how long, seconds. Without it, for good.
    pub for_s: Option<f32>,
    /// Again so often, seconds.
    pub every_s: Option<f32>,
    /// Until then, seconds.
    pub until_s: Option<f32>,
    /// Whose.
    pub robots: Selector,
    /// What.
    pub fault: Fault,
}

impl TimedFault {
    pub(crate) const fn times(&self) -> Times {
        Times {
            at_s: self.at_s,
            every_s: self.every_s,
            until_s: self.until_s,
        }
    }
}

/// A [`TimedFault`] as it stands in a file.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct FaultText {
    at_s: f32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    for_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    every_s: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    until_s: Option<f32>,
    #[serde(default)]
    robots: Selector,
    /// `fault`, and whatever belongs to it: an unknown key is one the fault does not have.
    #[serde(flatten)]
    fault: BTreeMap<String, toml::Value>,
}

/// Why what stands in a file is no fault.
enum NoFault {
    /// It has no name.
    Missing,
    /// There is none of that name, or not with these keys.
    Unreadable(toml::de::Error),
    /// A key does not belong to it.
    Unknown(String),
}

impl fmt::Display for NoFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => f.write_str("missing field `fault`"),
            Self::Unreadable(error) => f.write_str(error.message()),
            Self::Unknown(key) => write!(f, "unknown field `{key}`"),
        }
    }
}

impl TryFrom<FaultText> for TimedFault {
    type Error = NoFault;

    fn try_from(text: FaultText) -> Result<Self, NoFault> {
        if !text.fault.contains_key("fault") {
            return Err(NoFault::Missing);
        }
        let table: toml::Table = text.fault.into_iter().collect();
        let fault = Fault::deserialize(table.clone()).map_err(NoFault::Unreadable)?;
        // A fault without numbers would take no notice of keys that do not belong to it.
        let own = toml::Table::try_from(fault).unwrap_or_default();
        if let Some(key) = table.keys().find(|key| !own.contains_key(*key)) {
            return Err(NoFault::Unknown(key.clone()));
        }
        Ok(Self {
            at_s: text.at_s,
            for_s: text.for_s,
            every_s: text.every_s,
            until_s: text.until_s,
            robots: text.robots,
            fault,
        })
    }
}

impl From<TimedFault> for FaultText {
    fn from(timed: TimedFault) -> Self {
        // Faults are tables of numbers and words, which TOML can always hold.
        let fault = toml::Table::try_from(timed.fault).unwrap_or_default();
        Self {
            at_s: timed.at_s,
            for_s: timed.for_s,
            every_s: timed.every_s,
            until_s: timed.until_s,
            robots: timed.robots,
            fault: fault.into_iter().collect(),
        }
    }
}

/// A place for robots to go to. A robot that is in several goals visits them in the order of the
/// file.
///
/// It is one place for everyone (`x`, `y`), one for each in turn (`places`), or drawn from the seed
/// (`draw`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Goal {
    /// Whose.
    #[serde(skip_serializing_if = "Selector::is_all")]
    pub robots: Selector,
    /// Where, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x: Option<f32>,
    /// Where, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y: Option<f32>,
    /// Where each: the robots of this goal take turns at them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f32; 2]>,
    /// How to draw a place of its own for each robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub draw: Option<Draw>,
    /// A robot whose middle is this near has reached it, metres.
    pub r: f32,
    /// Robots are not sent there before, seconds since the beginning of the world.
    #[serde(skip_serializing_if = "is_zero")]
    pub at_s: f32,
    /// Whether robots are told to `goto`. Otherwise they get there by other means or not at all.
    pub tell: bool,
    /// A robot that is not on its way any more is sent again after this, seconds; 0 never.
    pub retry_s: f32,
}

// Serde hands a reference over.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(number: &f32) -> bool {
    *number == 0.0
}

/// How places are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Draw {
    /// Anywhere that is free, apart from the goals of others.
    Random,
    /// Across the middle of the arena from where the robot started.
    Opposite,
}

impl Default for Goal {
    fn default() -> Self {
        Self {
            robots: Selector::All,
            x: None,
            y: None,
            places: Vec::new(),
            draw: None,
            r: 0.25,
            at_s: 0.0,
            tell: true,
            retry_s: 5.0,
        }
    }
}

impl Goal {
    /// The first thing wrong with it: its key, and the rule. Places are within `half` of the
    /// middle.
    pub(super) fn validate(&self, half: [f32; 2]) -> Result<(), (String, String)> {
        let fail = |key: &str, rule: String| Err((key.to_owned(), rule));
        let ways = usize::from(self.x.is_some() || self.y.is_some())
            + usize::from(!self.places.is_empty())
            + usize::from(self.draw.is_some());
        if ways != 1 || self.x.is_some() != self.y.is_some() {
            return fail(
                "",
                "must have x and y, or places, or draw, and only one of these".to_owned(),
            );
        }
        if self.places.len() > MOST_ENTRIES {
            return fail("places", format!("must be at most {MOST_ENTRIES}"));
        }
        let fixed = self.x.zip(self.y).map(|(x, y)| (String::new(), [x, y]));
        let listed = self.places.iter().enumerate();
        let listed = listed.map(|(index, &place)| (format!("places[{index}]"), place));
        for (key, [x, y]) in fixed.into_iter().chain(listed) {
            // Not-a-number fails both comparisons.
            if !(x.abs() <= half[0] && y.abs() <= half[1]) {
                return fail(&key, format!("must lie in the arena, not at {x}, {y}"));
            }
        }
        for (key, value, low, high) in [
            ("r", self.r, 0.01, 100.0),
            ("at_s", self.at_s, 0.0, LONGEST_S),
            ("retry_s", self.retry_s, 0.0, LONGEST_S),
        ] {
            if !(low..=high).contains(&value) {
                return fail(key, format!("must be {low} to {high}, not {value}"));
            }
        }
        Ok(())
    }
}
