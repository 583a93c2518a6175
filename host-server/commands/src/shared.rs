//! What the other servers of a fleet must know of the commands of this one: enough to show them, and
//! to go on with them.
//!
//! A command is told before anybody is told that it was accepted, and a new number before it goes to
//! a robot. What robots answer is told a moment later: all servers hear the answers themselves, and
//! a robot that is asked once more answers from memory.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

use crawler_cluster::{Fields, HEAD};
use crawler_delivery::Class;
use crawler_protocol::open::{Open, Response};
use crawler_protocol::{Command, Reason, RobotId, Source};
use serde::{Deserialize, Serialize};

use super::pending::{CommandText, Leg, Store};
use super::record::{OutcomeStatus, Record};
use super::{CommandTable, Target};
use crawler_system::clock;

/// Answers to commands of other servers that are remembered, for the time it takes until one of them
/// is given up and its commands are ours.
const MOST_HEARD: usize = 65_536;

/// The command itself, in its field.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Head {
    command: CommandText,
    /// Whether it was for all robots.
    pub(super) swarm: bool,
    /// Until when it may be delivered, Unix milliseconds.
    pub(super) expires: u64,
    /// What settings go under.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    settings: Option<String>,
}

impl Head {
    pub(super) fn settings(&self) -> Option<Source> {
        Source::new(self.settings.as_deref()?).ok()
    }
}

/// One robot's part of it, in the robot's field. Short: there can be thousands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Part {
    /// `None` for pending.
    #[serde(rename = "s", skip_serializing_if = "Option::is_none")]
    pub(super) status: Option<OutcomeStatus>,
    /// Under which number it went, if that is not its id.
    #[serde(rename = "n", skip_serializing_if = "Option::is_none")]
    pub(super) seq: Option<u64>,
    /// How often the robot had started by then.
    #[serde(rename = "b", skip_serializing_if = "Option::is_none")]
    pub(super) boot: Option<u32>,
    /// Whether there is nothing left to deliver.
    #[serde(rename = "d", skip_serializing_if = "std::ops::Not::not")]
    pub(super) done: bool,
    #[serde(rename = "r", skip_serializing_if = "Option::is_none")]
    pub(super) reason: Option<Open<Reason>>,
    #[serde(rename = "t", skip_serializing_if = "Option::is_none")]
    pub(super) timestamp: Option<u64>,
}

/// A command for other servers, as it is when it is given; `None` when it cannot be written.
pub(super) fn fields<'a>(
    command: &Command,
    swarm: bool,
    settings: Option<&Source>,
    robots: impl IntoIterator<Item = (&'a RobotId, Option<u32>)>,
) -> Option<Fields> {
    let mut fields = Fields::new();
    fields.insert(HEAD.to_owned(), head(command, swarm, settings)?);
    for (robot, boot) in robots {
        let part = Part {
            boot,
            ..Part::default()
        };
        fields.insert(
            robot.as_str().to_owned(),
            serde_json::to_string(&part).ok()?,
        );
    }
    Some(fields)
}

fn head(command: &Command, swarm: bool, settings: Option<&Source>) -> Option<String> {
    let class = Class::of(&command.action);
    let head = Head {
        command: CommandText::new(command)?,
        swarm,
        expires: clock::unix_ms().saturating_add(class.life_ms()),
        settings: settings
            .filter(|_| class == Class::Setting)
            .map(|source| source.as_str().to_owned()),
    };
    serde_json::to_string(&head).ok()
}

/// Reads a command of another server, or of an earlier start; `None` when it is none.
pub(super) fn read(fields: &Fields) -> Option<(Head, Command, BTreeMap<RobotId, Part>)> {
    let head: Head = serde_json::from_str(fields.get(HEAD)?).ok()?;
    let command = head.command.command()?;
    let parts = fields.iter().filter(|(name, _)| *name != HEAD);
    let parts = parts
        .map(|(name, text)| Some((RobotId::new(name).ok()?, serde_json::from_str(text).ok()?)));
    Some((head, command, parts.collect::<Option<_>>()?))
}

/// A new number that a command is about to go under.
#[derive(Debug, Clone, Copy)]
struct Reserved {
    leg: Leg,
    /// Whether the other servers know.
    safe: bool,
}

/// What there is to tell of a command.
#[derive(Debug)]
pub struct Change {
    /// The command.
    pub id: u64,
    /// What the others are to have of it.
    pub fields: Fields,
    /// Whether nothing is left to do.
    pub finished: bool,
    robots: BTreeSet<RobotId>,
    numbers: Vec<(RobotId, u64)>,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct SharedTable {
    /// What is to be delivered, by command and robot.
    legs: BTreeMap<u64, BTreeMap<RobotId, Leg>>,
    reserved: BTreeMap<(u64, RobotId), Reserved>,
    /// What the others do not know yet.
    dirty: BTreeMap<u64, BTreeSet<RobotId>>,
    /// Commands of which all robots are.
    all_dirty: BTreeSet<u64>,
    retracted: Vec<u64>,
    heard: Heard,
    /// What settings of this server go under.
    pub(super) settings: Option<Source>,
}

impl SharedTable {
    /// Notes a command that is to be delivered.
    pub(super) fn owe(
        &mut self,
        id: u64,
        robots: impl IntoIterator<Item = (RobotId, Option<u32>)>,
    ) {
        let robots = robots.into_iter();
        let legs = robots.map(|(robot, boot)| (robot, Leg { seq: id, boot }));
        let legs: BTreeMap<_, _> = legs.collect();
        if !legs.is_empty() {
            self.legs.insert(id, legs);
        }
    }

    /// Notes a delivery that was another server's, or an earlier start's.
    pub(super) fn owe_one(&mut self, id: u64, robot: RobotId, leg: Leg) {
        let legs = self.legs.entry(id).or_default();
        legs.insert(robot, leg);
    }

    /// Notes that there is something new to tell.
    pub(super) fn touch(&mut self, id: u64, robot: &RobotId) {
        self.dirty.entry(id).or_default().insert(robot.clone());
    }

    /// Notes that everything is to be told again.
    pub(super) fn touch_all(&mut self, id: u64) {
        self.all_dirty.insert(id);
    }

    /// Takes back a command that was told of and did not go.
    pub(super) fn retract(&mut self, id: u64) {
        self.retracted.push(id);
    }

    pub(super) fn take_retracted(&mut self) -> Vec<u64> {
        std::mem::take(&mut self.retracted)
    }

    /// Remembers an answer to a command that is not ours.
    pub(super) fn heard(&mut self, response: &Response) {
        self.heard.push(response);
    }

    /// The answer to a command that has just become ours.
    pub(super) fn recall(&self, robot: &RobotId, seq: u64) -> Option<Response> {
        self.heard.get(robot, seq)
    }

    /// Commands that something is left to do for, beside those that wait for an answer.
    pub(super) fn owed(&self) -> impl Iterator<Item = u64> {
        self.legs.keys().copied()
    }

    /// Forgets a command that is another server's now.
    pub(super) fn forget(&mut self, id: u64) {
        self.legs.remove(&id);
        self.dirty.remove(&id);
        self.all_dirty.remove(&id);
        self.reserved.retain(|(known, _), _| *known != id);
    }

    fn part(&self, record: &Record, robot: &RobotId) -> Option<String> {
        let outcome = record.outcomes.get(robot)?;
        let leg = self.legs.get(&record.id).and_then(|legs| legs.get(robot));
        let leg = leg.copied();
        let coming = self.reserved.get(&(record.id, robot.clone()));
        let seq = coming
            .map(|coming| coming.leg.seq)
            .or(leg.map(|leg| leg.seq));
        let boot = coming.map(|coming| coming.leg.boot);
        let part = Part {
            status: Some(outcome.status).filter(|status| *status != OutcomeStatus::Pending),
            seq: seq.filter(|seq| *seq != record.id),
            boot: boot.or(leg.map(|leg| leg.boot)).flatten(),
            done: leg.is_none(),
            reason: outcome.reason,
            timestamp: outcome.timestamp,
        };
        serde_json::to_string(&part).ok()
    }

    /// Everything that there is to tell of a command.
    pub(super) fn all(&self, record: &Record) -> Option<Fields> {
        let swarm = record.target == Target::Swarm;
        let mut fields = Fields::new();
        let head = head(&record.command, swarm, record.settings.as_ref())?;
        fields.insert(HEAD.to_owned(), head);
        for robot in record.outcomes.keys() {
            fields.insert(robot.as_str().to_owned(), self.part(record, robot)?);
        }
        Some(fields)
    }
}

impl Store for SharedTable {
    fn reserved(&mut self, id: u64, robot: &RobotId, above: u64) -> Option<u64> {
        let reserved = self.reserved.get(&(id, robot.clone()))?;
        Some(reserved.leg.seq).filter(|seq| *seq > above)
    }

    fn may_go(&mut self, id: u64, robot: &RobotId, seq: u64, boot: Option<u32>) -> bool {
        let key = (id, robot.clone());
        let leg = Leg { seq, boot };
        match self.reserved.get(&key) {
            Some(known) if known.leg == leg => {
                if known.safe {
                    self.reserved.remove(&key);
                    self.owe_one(id, key.1, leg);
                    return true;
                }
            }
            _ => {
                let safe = false;
                self.touch(id, robot);
                self.reserved.insert(key, Reserved { leg, safe });
            }
        }
        false
    }

    fn done(&mut self, id: u64, robot: &RobotId) {
        self.reserved.remove(&(id, robot.clone()));
        if let Some(legs) = self.legs.get_mut(&id)
            && legs.remove(robot).is_some()
        {
            if legs.is_empty() {
                self.legs.remove(&id);
            }
            self.touch(id, robot);
        }
    }
}

impl CommandTable {
    /// Takes what the other servers do not know yet.
    pub(super) fn take_changes(&mut self) -> Vec<Change> {
        let Some(shared) = &mut self.shared else {
            return Vec::new();
        };
        let mut dirty = std::mem::take(&mut shared.dirty);
        for id in std::mem::take(&mut shared.all_dirty) {
            let record = self.records.get(&id);
            let robots = record.into_iter().flat_map(|record| record.outcomes.keys());
            dirty.entry(id).or_default().extend(robots.cloned());
        }
        let changes = dirty.into_iter().map(|(id, robots)| {
            let mut change = Change {
                id,
                fields: Fields::new(),
                finished: !self.open.contains(&id) && !shared.legs.contains_key(&id),
                robots,
                numbers: Vec::new(),
            };
            for robot in &change.robots {
                let record = self.records.get(&id);
                if let Some(part) = record.and_then(|record| shared.part(record, robot)) {
                    change.fields.insert(robot.as_str().to_owned(), part);
                    let reserved = shared.reserved.get(&(id, robot.clone()));
                    let seq = reserved.map(|reserved| reserved.leg.seq);
                    change.numbers.extend(seq.map(|seq| (robot.clone(), seq)));
                }
            }
            change
        });
        changes.collect()
    }
}

impl SharedTable {
    /// The others know of a change.
    pub(super) fn written(&mut self, change: Change) {
        for (robot, seq) in change.numbers {
            if let Some(reserved) = self.reserved.get_mut(&(change.id, robot))
                && reserved.leg.seq == seq
            {
                reserved.safe = true;
            }
        }
    }

    /// The others could not be told of a change.
    pub(super) fn unwritten(&mut self, change: Change) {
        self.dirty
            .entry(change.id)
            .or_default()
            .extend(change.robots);
    }
}

/// Answers, the oldest first.
#[derive(Debug, Default)]
struct Heard {
    answers: HashMap<(RobotId, u64), Response>,
    order: VecDeque<(RobotId, u64)>,
}

impl Heard {
    fn push(&mut self, response: &Response) {
        let key = (response.robot.clone(), response.seq);
        // A final answer follows `accepted`, and stays.
        if self.answers.insert(key.clone(), response.clone()).is_none() {
            self.order.push_back(key);
        }
        while self.order.len() > MOST_HEARD {
            if let Some(oldest) = self.order.pop_front() {
                self.answers.remove(&oldest);
            }
        }
    }

    fn get(&self, robot: &RobotId, seq: u64) -> Option<Response> {
        self.answers.get(&(robot.clone(), seq)).cloned()
    }
}
