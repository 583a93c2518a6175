//! The commands of one of several servers: told to the others, and taken over from them.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use crawler_cluster::{Fields, Numbers};
use crawler_delivery::{Class, End, SETTINGS};
use crawler_protocol::{RobotId, Source};

use super::journal::JournalEntry;
use super::pending::Pending;
use super::shared::{Change, SharedTable};
use super::{Book, CommandCenter, CommandView, OutcomeStatus};
use crawler_cluster::ClusterMembership;
use crawler_system::clock;

/// A command of another server, as it is; `None` when it is none.
pub fn view_of(id: u64, fields: &Fields) -> Option<CommandView> {
    let pending = Pending::of_fields(id, fields, Instant::now())?;
    Some(pending.record.view())
}

impl CommandCenter {
    /// Makes it one of several.
    #[must_use]
    pub fn with_cluster(mut self, membership: &Arc<ClusterMembership>) -> Self {
        self.membership = Some(Arc::clone(membership));
        self.book().table.shared = Some(SharedTable::default());
        self
    }

    /// From here on commands have the numbers of this slot, above `greatest`.
    pub fn share(&self, numbers: Numbers, greatest: u64) {
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
    pub fn changes(&self) -> Vec<Change> {
        self.book().table.take_changes()
    }

    /// They were told of it.
    pub fn written(&self, change: Change) {
        if let Some(shared) = &mut self.book().table.shared {
            shared.written(change);
        }
    }

    /// They could not be told of it.
    pub fn unwritten(&self, change: Change) {
        if let Some(shared) = &mut self.book().table.shared {
            shared.unwritten(change);
        }
    }

    /// Takes the commands that they were told of for nothing.
    pub fn retracted(&self) -> Vec<u64> {
        let mut book = self.book();
        let shared = book.table.shared.as_mut();
        shared.map_or_else(Vec::new, SharedTable::take_retracted)
    }

    /// Puts back one that could not be taken back.
    pub fn retract(&self, id: u64) {
        if let Some(shared) = &mut self.book().table.shared {
            shared.retract(id);
        }
    }

    /// Everything that something is left to do for, for servers that have been told nothing.
    pub fn everything(&self) -> Vec<(u64, Fields)> {
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
    pub fn let_go(&self) {
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
    pub fn take_over(&self, id: u64, fields: &Fields, now: Instant) -> Option<CommandView> {
        let mut book = self.book();
        let book = &mut *book;
        if book.table.records.contains_key(&id) {
            return None;
        }
        let shared = book.table.shared.as_mut()?;
        // Whatever comes of it, it is written.
        shared.touch_all(id);
        let Some(pending) = Pending::of_fields(id, fields, now) else {
            tracing::warn!(id, "a command of another server is none, or was forgotten");
            return None;
        };
        let (class, left) = (pending.class(), pending.left_ms(clock::unix_ms()));
        let Pending {
            mut record,
            legs,
            expires,
        } = pending;
        let at = self.ms(now);
        let recall = |book: &Book, robot: &RobotId, seq| {
            let shared = book.table.shared.as_ref()?;
            shared.recall(robot, seq)
        };
        for (robot, leg) in legs {
            if let Some(answer) = recall(book, &robot, leg.seq) {
                record.answer(&answer, true);
            } else if left == 0 {
                record.over(&robot, End::Unanswered);
            } else {
                book.resume(id, class, (robot, leg), at, left);
            }
        }
        // Those that had said `accepted`.
        let waiting = record.outcomes.iter();
        let waiting = waiting.filter(|(_, outcome)| outcome.status == OutcomeStatus::Accepted);
        let waiting: Vec<RobotId> = waiting.map(|(robot, _)| robot.clone()).collect();
        for robot in waiting {
            let numbers = record.numbers.iter().copied().chain([id]);
            let answers = numbers.filter_map(|seq| recall(book, &robot, seq));
            for answer in answers.collect::<Vec<_>>() {
                record.answer(&answer, true);
            }
        }
        for seq in &record.numbers {
            book.table.sequence.above(*seq);
        }
        book.table.sequence.above(id);
        if let (Class::Plain | Class::Setting, Some(journal)) = (class, &mut book.table.journal)
            && let Some(owed) = JournalEntry::new(
                &record,
                expires,
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
        book.remember(record);
        over
    }
}
