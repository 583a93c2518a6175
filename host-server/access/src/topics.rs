//! What each client of the broker may publish and subscribe.
//!
//! [`TABLE`] is the whole policy: [`may`] reads nothing else, and what no row allows is refused.
//! A subscription is allowed only when one row covers every topic that its filter could match. A row may leave
//! topics out: a filter that selects nothing else is refused, and of a wider one the broker delivers all but
//! these ([`is_withheld`]).

use core::fmt;

use crawler_protocol::{Fleet, RobotId, Topic};

use crate::{LearnTopic, Role};

/// Longest topic or filter that is looked at, in bytes. The contract's longest topic has 80.
pub const MAX_TOPIC: usize = 256;

/// Who a client of the broker turned out to be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Principal {
    /// The server itself.
    Server,
    /// A robot with a secret of its own, or one of a simulator.
    Robot(RobotId),
    /// The part of a simulator that is no robot: its controls and its overhead camera.
    Simulator,
    /// A machine of federated learning, by its name without `learner-`.
    Learner(RobotId),
    /// A person.
    User(Role),
}

/// What a client wants to do with a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Act {
    /// Publish to a topic, its will included.
    Publish,
    /// Subscribe to a filter.
    Subscribe,
}

/// Whom a row is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Who {
    /// [`Principal::Server`].
    Server,
    /// [`Principal::Robot`].
    Robot,
    /// [`Principal::Simulator`].
    Simulator,
    /// [`Principal::Learner`].
    Learner,
    /// [`Principal::User`] of this role or a higher one.
    User(Role),
}

/// One rule: who may do what to which topics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// Whom it allows something.
    pub who: Who,
    /// What it allows.
    pub act: Act,
    /// Which topics: a filter in which `{fleet}` and `{own}` stand for the names of the fleet and
    /// of the robot or the learner.
    pub topics: &'static str,
    /// Which of these it leaves out, in the same form. Only rows of people do.
    pub but: Option<&'static str>,
    /// What for.
    pub what: &'static str,
}

const fn row(who: Who, act: Act, topics: &'static str, what: &'static str) -> Row {
    Row {
        who,
        act,
        topics,
        but: None,
        what,
    }
}

impl Row {
    const fn without(mut self, topics: &'static str) -> Self {
        self.but = Some(topics);
        self
    }
}

use Act::{Publish, Subscribe};

/// Every rule. What is not here is refused.
// One line is one rule.
#[rustfmt::skip]
pub const TABLE: &[Row] = &[
    row(Who::Server, Publish, "#", "everything"),
    row(Who::Server, Subscribe, "#", "everything, shared subscriptions too"),
    row(Who::Robot, Publish, "{fleet}/response/robot/{own}", "its answers to commands"),
    row(Who::Robot, Publish, "{fleet}/status/{own}", "what it is; its will"),
    row(Who::Robot, Publish, "{fleet}/heartbeat/{own}", "that it is alive"),
    row(Who::Robot, Publish, "{fleet}/telemetry/{own}", "what it measures"),
    row(Who::Robot, Publish, "{fleet}/vision/{own}", "what it recognises"),
    row(Who::Robot, Publish, "{fleet}/image/{own}", "what it sees"),
    row(Who::Robot, Publish, "{fleet}/logs/{own}", "its log"),
    row(Who::Robot, Publish, "{fleet}/map/{own}", "its map, when it is asked for it"),
    row(Who::Robot, Publish, "{fleet}/parameters/{own}", "its parameters"),
    row(Who::Robot, Publish, "{fleet}/ota/{own}", "how an update goes"),
    row(Who::Robot, Subscribe, "{fleet}/command/swarm", "commands to all"),
    row(Who::Robot, Subscribe, "{fleet}/command/robot/{own}", "commands to itself"),
    row(Who::Robot, Subscribe, "{fleet}/command/experiment", "commands to those who take part"),
    row(Who::Robot, Subscribe, "{fleet}/time", "the time of the server"),
    row(Who::Robot, Subscribe, "{fleet}/pose/{own}", "where a camera above sees it"),
    row(Who::Robot, Subscribe, "{fleet}/cell/+/+", "who is near"),
    row(Who::Robot, Subscribe, "{fleet}/ota/{own}", "offers of updates"),
    row(Who::Robot, Subscribe, "{fleet}/simulator/command", "faults, in a simulator and on a bench"),
    row(Who::Simulator, Publish, "{fleet}/pose/+", "where its camera sees robots"),
    row(Who::Simulator, Publish, "{fleet}/simulator/response", "answers to its controls"),
    row(Who::Simulator, Subscribe, "{fleet}/simulator/#", "its controls"),
    row(Who::Simulator, Subscribe, "{fleet}/time", "the time of the server"),
    row(Who::Learner, Publish, "{fleet}/learn/+/update/{own}", "what it learned in a round"),
    row(Who::Learner, Subscribe, "{fleet}/learn/+/round", "rounds of federated learning"),
    row(Who::User(Role::Viewer), Subscribe, "{fleet}/#", "everything of the fleet but updates").without("{fleet}/ota/#"),
    row(Who::User(Role::Operator), Publish, "{fleet}/command/swarm", "commands to all"),
    row(Who::User(Role::Operator), Publish, "{fleet}/command/robot/+", "commands to one robot"),
    row(Who::User(Role::Operator), Publish, "{fleet}/command/experiment", "commands to those who take part"),
    row(Who::User(Role::Operator), Publish, "{fleet}/simulator/command", "controls of a simulator"),
    row(Who::User(Role::Operator), Publish, "{fleet}/pose/+", "where a tracker of one's own sees robots"),
];

/// Whether `who` may do `act` to `topic_or_filter`.
///
/// Where a row has a `+`, only a topic of the contract is published: there must be a robot id in
/// its place, or the number of a cell, and nothing else. In a learner's row it is the number of a run.
#[must_use]
pub fn may(who: &Principal, act: Act, fleet: &Fleet, topic_or_filter: &str) -> bool {
    let text = topic_or_filter;
    if !well_formed(text, act) {
        return false;
    }
    let own = match who {
        Principal::Robot(own) | Principal::Learner(own) => Some(own.as_str()),
        Principal::Server | Principal::Simulator | Principal::User(_) => None,
    };
    let fills = |row: &Row| {
        if act == Act::Subscribe || !row.topics.contains('+') {
            return true;
        }
        match row.who {
            Who::Learner => LearnTopic::parse(fleet, text).is_some(),
            Who::Server | Who::Robot | Who::Simulator | Who::User(_) => {
                Topic::parse(fleet, text).is_ok()
            }
        }
    };
    TABLE
        .iter()
        .filter(|row| row.act == act && row.who.includes(who))
        .any(|row| {
            let covered = |topics| covers(topics, fleet.as_str(), own, text);
            covered(row.topics) && !row.but.is_some_and(covered) && fills(row)
        })
}

/// Whether people are not told of a topic, whatever they have subscribed to: a row allows more to them than
/// that, and leaves it out.
#[must_use]
pub fn is_withheld(fleet: &Fleet, topic: &str) -> bool {
    let left_out = TABLE.iter().filter_map(|row| row.but);
    let mut left_out = left_out.map(|topics| covers(topics, fleet.as_str(), None, topic));
    left_out.any(|within| within)
}

impl Who {
    fn includes(self, who: &Principal) -> bool {
        match (self, who) {
            (Self::Server, Principal::Server)
            | (Self::Robot, Principal::Robot(_))
            | (Self::Simulator, Principal::Simulator)
            | (Self::Learner, Principal::Learner(_)) => true,
            (Self::User(least), Principal::User(role)) => *role >= least,
            (Self::Server | Self::Robot | Self::Simulator | Self::Learner | Self::User(_), _) => {
                false
            }
        }
    }
}

/// Whether MQTT allows the text as a topic, or as a filter.
fn well_formed(text: &str, act: Act) -> bool {
    if text.is_empty() || text.len() > MAX_TOPIC || text.chars().any(char::is_control) {
        return false;
    }
    match act {
        Act::Publish => !text.contains(['+', '#']),
        Act::Subscribe => {
            let mut levels = text.split('/').rev();
            // `#` ends a filter, and a wildcard is alone on its level.
            let last = levels.next().unwrap_or_default();
            (last == "#" || last == "+" || !last.contains(['+', '#']))
                && levels.all(|level| level == "+" || !level.contains(['+', '#']))
        }
    }
}

/// Whether every topic that `filter` matches is one that `allowed` matches too. A topic is a filter
/// that matches itself.
fn covers(allowed: &str, fleet: &str, own: Option<&str>, filter: &str) -> bool {
    let mut wanted = filter.split('/');
    for level in allowed.split('/') {
        if level == "#" {
            // Whatever comes here, nothing included: `a/#` matches `a`.
            return true;
        }
        let Some(wanted) = wanted.next() else {
            return false;
        };
        let within = match level {
            "+" => wanted != "#",
            "{fleet}" => wanted == fleet,
            "{own}" => own == Some(wanted),
            word => wanted == word,
        };
        if !within {
            return false;
        }
    }
    wanted.next().is_none()
}

impl fmt::Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
        })
    }
}

impl fmt::Display for Who {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Server => f.pad("server"),
            Self::Robot => f.pad("robot"),
            Self::Simulator => f.pad("simulator"),
            Self::Learner => f.pad("learner"),
            Self::User(role) => role.fmt(f),
        }
    }
}

#[cfg(test)]
#[path = "topics_tests.rs"]
mod tests;
