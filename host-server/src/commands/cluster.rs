//! The commands of one of several servers: told to the others, and taken over from them.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use crawler_cluster::{Fields, Numbers};
use crawler_delivery::{Class, End, SETTINGS};
use crawler_protocol::{Command, RobotId, Source};

use super::journal::Owed;
use super::record::Outcome;
use super::shared::{Change, SharedTable, read};
use super::{CommandCenter, CommandView, OutcomeStatus, Record, Target};
use crate::clock;
use crate::cluster::ClusterMembership;

/// What was another server's, read and ready.
struct Inherited {
    record: Record,
    /// What is to be delivered: robot, number, boot.
    legs: Vec<(RobotId, u64, Option<u32>)>,
    expires: u64,
}

impl Inherited {
    fn read(id: u64, fields: &Fields, now: Instant) -> Option<Self> {
        let (head, command, parts) = read(fields)?;
        let class = Class::of(&command.action);
        let target = match parts.keys().next() {
            Some(robot) if !head.swarm => Target::Robot(robot.clone()),
            _ => Target::Swarm,
        };
        // Its time and number may be those of a later delivery.
        let settings = head.settings();
        let mut record = Record::new(command, target, parts.keys().cloned(), now);
        record.id = id;
        record.settings = settings.filter(|_| class == Class::Setting);
        let mut legs = Vec::new();
        for (robot, part) in parts {
            let status = part.status.unwrap_or(OutcomeStatus::Pending);
            let seq = part.seq.unwrap_or(id);
            record.restore(
                &robot,
                Outcome {
                    status,
                    reason: part.reason,
                    timestamp: part.timestamp,
                    // It was sent and is waited for, from here on anew.
                    went: part.done.then_some(now),
                },
            );
            if seq != id && !record.numbers.contains(&seq) {
                record.numbers.push(seq);
            }
            if !part.done {
                legs.push((robot, seq, part.boot));
            }
        }
        Some(Self {
            record,
            legs,
            expires: head.expires,
        })
    }
}

/// A command of another server, as it is; `None` when it is none.
pub(crate) fn view_of(id: u64, fields: &Fields) -> Option<CommandView> {
    let inherited = Inherited::read(id, fields, Instant::now())?;
    Some(inherited.record.view())
}

impl CommandCenter {
    /// Makes it one of several.
    pub(crate) fn with_cluster(mut self, membership: &Arc<ClusterMembership>) -> Self {
        self.membership = Some(Arc::clone(membership));
        self.book().table.shared = Some(SharedTable::default());
        self
    }

    /// From here on commands have the numbers of this slot, above `greatest`.
    pub(crate) fn share(&self, numbers: Numbers, greatest: u64) {
        let mut book = self.book();
        book.table.sequence.share(numbers, greatest);
        if let Some(shared) = &mut book.table.shared {
            // Robots compare numbers per source, and two servers do not wait for each other.
            let own = match numbers.slot() {
                0 => SETTINGS.to_owned(),
                slot => format!("{SETTINGS}-{slot}"),
            };
            shared.settings = Source::new(&own).ok();
        }
    }

    /// Takes what the other servers are to be told.
    pub(crate) fn changes(&self) -> Vec<Change> {
        self.book().table.take_changes()
    }

    /// They were told of it.
    pub(crate) fn written(&self, change: Change) {
        if let Some(shared) = &mut self.book().table.shared {
            shared.written(change);
        }
    }

    /// They could not be told of it.
    pub(crate) fn unwritten(&self, change: Change) {
        if let Some(shared) = &mut self.book().table.shared {
            shared.unwritten(change);
        }
    }

    /// Takes the commands that they were told of for nothing.
    pub(crate) fn retracted(&self) -> Vec<u64> {
        let mut book = self.book();
        let shared = book.table.shared.as_mut();
        shared.map_or_else(Vec::new, SharedTable::take_retracted)
    }

    /// Puts back one that could not be taken back.
    pub(crate) fn retract(&self, id: u64) {
        if let Some(shared) = &mut self.book().table.shared {
            shared.retract(id);
        }
    }

    /// Everything that something is left to do for, for servers that have been told nothing.
    pub(crate) fn everything(&self) -> Vec<(u64, Fields)> {
        let book = self.book();
        let Some(shared) = &book.table.shared else {
            return Vec::new();
        };
        let open = book.table.open.iter().copied();
        let ids: BTreeSet<u64> = open.chain(shared.owed()).collect();
        let records = ids.into_iter().filter_map(|id| book.table.records.get(&id));
        records
            .filter_map(|record| Some((record.id, shared.all(record)?)))
            .collect()
    }

    /// Drops everything that is under way: another server goes on with it.
    pub(crate) fn let_go(&self) {
        let mut book = self.book();
        let book = &mut *book;
        let open: Vec<u64> = book.table.open.iter().copied().collect();
        let shared = book.table.shared.as_ref();
        let owed: Vec<u64> = shared.map_or_else(Vec::new, |shared| shared.owed().collect());
        for id in open.into_iter().chain(owed) {
            if let Some(record) = book.table.records.remove(&id) {
                book.table.outcomes -= record.outcomes.len();
                for robot in record.outcomes.keys() {
                    book.delivery.withdraw(id, robot);
                }
                for seq in record.numbers {
                    book.table.numbers.remove(&seq);
                }
            }
            book.table.open.remove(&id);
            if let Some(shared) = &mut book.table.shared {
                shared.forget(id);
            }
        }
        if let Some(journal) = &mut book.table.journal {
            journal.clear();
        }
    }

    /// Goes on with a command that was another server's, or this one's before it was started anew.
    /// Returns it when it is over by that.
    pub(crate) fn take_over(&self, id: u64, fields: &Fields, now: Instant) -> Option<CommandView> {
        let mut book = self.book();
        let book = &mut *book;
        if book.table.records.contains_key(&id) {
            return None;
        }
        let shared = book.table.shared.as_mut()?;
        // Whatever comes of it, it is written.
        shared.touch_all(id);
        let Some(inherited) = Inherited::read(id, fields, now) else {
            tracing::warn!(id, "a command of another server is none, or was forgotten");
            return None;
        };
        let Inherited {
            mut record,
            legs,
            expires,
        } = inherited;
        let class = Class::of(&record.command.action);
        let at = self.ms(now);
        // A clock that was set must not keep a command for longer than its life.
        let left = expires
            .saturating_sub(clock::unix_ms())
            .min(class.life_ms());
        for (robot, seq, boot) in legs {
            let answer = shared.recall(&robot, seq);
            if let Some(answer) = answer {
                record.answer(&answer, true);
            } else if left == 0 {
                record.over(&robot, End::Unanswered);
            } else {
                let (delivery, flight) = (&mut book.delivery, (seq, boot));
                delivery.resume(id, &robot, class, flight, (at, at + left));
                shared.owe_one(id, robot, seq, boot);
            }
        }
        // Those that had said `accepted`.
        let waiting = record.outcomes.iter();
        let waiting = waiting.filter(|(_, outcome)| outcome.status == OutcomeStatus::Accepted);
        let waiting: Vec<RobotId> = waiting.map(|(robot, _)| robot.clone()).collect();
        for robot in waiting {
            let numbers = record.numbers.iter().copied().chain([id]);
            let answers = numbers.filter_map(|seq| shared.recall(&robot, seq));
            for answer in answers.collect::<Vec<_>>() {
                record.answer(&answer, true);
            }
        }
        for seq in &record.numbers {
            book.table.numbers.insert(*seq, id);
            book.table.sequence.above(*seq);
        }
        book.table.sequence.above(id);
        if let (Class::Plain | Class::Setting, Some(journal)) = (class, &mut book.table.journal)
            && let Some(owed) = Owed::new(
                &Command {
                    seq: id,
                    ..record.command.clone()
                },
                expires,
                record.target == Target::Swarm,
                record
                    .outcomes
                    .iter()
                    .filter(|(_, outcome)| outcome.status.is_open())
                    .map(|(robot, _)| (robot.clone(), book.delivery.boot(robot))),
            )
        {
            // The others know of it; nobody waits for this disk.
            journal.accepted(owed);
        }
        let over = (!record.is_open()).then(|| record.view());
        if over.is_none() {
            book.table.open.insert(id);
        }
        book.table.outcomes += record.outcomes.len();
        book.table.records.insert(id, record);
        over
    }
}
