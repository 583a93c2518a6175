//! A command that something is left to do for, and where it is kept until that is done.
//!
//! Here it is a [`Record`] with what is to be delivered, a [`Leg`] for each robot. So that it outlives this
//! server it is kept in two [`Store`]s as well: in the journal as [`JournalEntry`], a line of JSON, and for other servers as
//! [`Fields`] in Redis. Both are read back into the same [`Pending`].

use std::time::Instant;

use crawler_cluster::Fields;
use crawler_delivery::{Class, Ms};
use crawler_protocol::{Command, MAX_MESSAGE, RobotId};
use serde::{Deserialize, Serialize};

use super::journal::JournalEntry;
use super::record::{Outcome, OutcomeStatus, Record};
use super::{Book, Target, shared};

/// A command as it was given, as JSON text: how it is kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct CommandText(String);

impl CommandText {
    /// `None` when the command cannot be written.
    pub(super) fn new(command: &Command) -> Option<Self> {
        let mut buffer = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buffer).ok()?;
        let text = std::str::from_utf8(buffer.get(..length)?).ok()?;
        Some(Self(text.to_owned()))
    }

    /// The command; `None` when a newer or older server wrote what is none here.
    pub(super) fn command(&self) -> Option<Command> {
        Command::parse(self.0.as_bytes()).ok()
    }
}

/// How a command went, or will go, to a robot that has not answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Leg {
    /// Under which number it went, if it went.
    pub(super) seq: u64,
    /// How often the robot had started by then.
    pub(super) boot: Option<u32>,
}

/// Where it is kept, beside this process, what is to be delivered.
pub(super) trait Store {
    /// The number that was set aside for a command that waited; none that it could not go under.
    fn reserved(&mut self, id: u64, robot: &RobotId, above: u64) -> Option<u64>;

    /// Whether a command may go under a new number: it is safe, since whoever goes on with it must not give it yet
    /// another. If it is not, it is made so, and the command goes with a later poll.
    fn may_go(&mut self, id: u64, robot: &RobotId, seq: u64, boot: Option<u32>) -> bool;

    /// Notes that there is nothing more to deliver.
    fn done(&mut self, id: u64, robot: &RobotId);
}

/// What was another server's, or an earlier start's, read and ready.
pub(super) struct Pending {
    pub(super) record: Record,
    /// What is to be delivered.
    pub(super) legs: Vec<(RobotId, Leg)>,
    /// Until when, Unix milliseconds.
    pub(super) expires: u64,
}

impl Pending {
    /// Of a line of the journal; `None` when it has no command of this program.
    pub(super) fn of_entry(owed: &JournalEntry, now: Instant) -> Option<Self> {
        let legs = owed.robots.iter();
        let legs = legs.filter_map(|(name, leg)| Some((RobotId::new(name).ok()?, *leg)));
        let legs: Vec<_> = legs.collect();
        let robots = legs.iter().map(|(robot, _)| robot);
        let mut record = record(owed.id, owed.command.command()?, owed.swarm, robots, now);
        for (_, leg) in &legs {
            record.went_as(leg.seq);
        }
        let expires = owed.expires;
        Some(Self {
            record,
            legs,
            expires,
        })
    }

    /// Of what another server, or an earlier start, told; `None` when that is no command of this program.
    pub(super) fn of_fields(id: u64, fields: &Fields, now: Instant) -> Option<Self> {
        let (head, command, parts) = shared::read(fields)?;
        // Its time and number may be those of a later delivery.
        let mut record = record(id, command, head.swarm, parts.keys(), now);
        let is_setting = Class::of(&record.command.action) == Class::Setting;
        record.settings = head.settings().filter(|_| is_setting);
        let mut legs = Vec::new();
        for (robot, part) in parts {
            let seq = part.seq.unwrap_or(id);
            record.restore(
                &robot,
                Outcome {
                    status: part.status.unwrap_or(OutcomeStatus::Pending),
                    reason: part.reason,
                    timestamp: part.timestamp,
                    // It was sent and is waited for, from here on anew.
                    went: part.done.then_some(now),
                },
            );
            record.went_as(seq);
            if !part.done {
                let boot = part.boot;
                legs.push((robot, Leg { seq, boot }));
            }
        }
        Some(Self {
            record,
            legs,
            expires: head.expires,
        })
    }

    pub(super) fn class(&self) -> Class {
        Class::of(&self.record.command.action)
    }

    /// For how long it may still be delivered. A clock that was set must not keep a command for longer than its life.
    pub(super) fn left_ms(&self, unix_ms: u64) -> Ms {
        let left = self.expires.saturating_sub(unix_ms);
        left.min(self.class().life_ms())
    }
}

/// A command that was taken up from where it was kept.
fn record<'a>(
    id: u64,
    command: Command,
    swarm: bool,
    robots: impl Iterator<Item = &'a RobotId> + Clone,
    now: Instant,
) -> Record {
    let target = match robots.clone().next() {
        Some(robot) if !swarm => Target::Robot(robot.clone()),
        _ => Target::Swarm,
    };
    let mut record = Record::new(command, target, robots.cloned(), now);
    record.id = id;
    record
}

impl Book {
    /// Goes on delivering a command to a robot: until when, after `at`.
    pub(super) fn resume(&mut self, id: u64, class: Class, to: (RobotId, Leg), at: Ms, left: Ms) {
        let (robot, leg) = to;
        let flight = (leg.seq, leg.boot);
        self.delivery
            .resume(id, &robot, class, flight, (at, at + left));
        if let Some(shared) = &mut self.table.shared {
            shared.owe_one(id, robot, leg);
        }
    }

    /// Remembers a command that goes on.
    pub(super) fn remember(&mut self, record: Record) {
        let id = record.id;
        for seq in &record.numbers {
            self.table.numbers.insert(*seq, id);
        }
        if record.is_open() {
            self.table.open.insert(id);
        }
        self.table.outcomes += record.outcomes.len();
        self.table.records.insert(id, record);
    }
}
