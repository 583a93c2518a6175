//! Going on where the last server ended.

use std::time::Instant;

use crawler_delivery::Class;
use crawler_protocol::RobotId;

use super::journal::Journal;
use super::{CommandCenter, Record, Target};
use crate::clock;

impl CommandCenter {
    /// Goes on with what the last server owed, and writes down what this one does.
    pub(crate) fn with_journal(self, journal: Journal, now: Instant) -> Self {
        {
            let mut book = self.book();
            let book = &mut *book;
            let (unix, at) = (clock::unix_ms(), self.ms(now));
            let mut stale = Vec::new();
            for owed in journal.owed() {
                // A clock that was set must not keep a command for longer than its life.
                let Some(command) = owed.command() else {
                    tracing::warn!(id = owed.id, "a command in the journal is none");
                    continue;
                };
                let class = Class::of(&command.action);
                let left = owed.expires.saturating_sub(unix).min(class.life_ms());
                let legs = owed.robots.iter().filter_map(|(name, leg)| {
                    let robot = RobotId::new(name).ok()?;
                    Some((robot, *leg))
                });
                let legs: Vec<_> = legs.collect();
                let target = match legs.first() {
                    Some((robot, _)) if !owed.swarm => Target::Robot(robot.clone()),
                    _ => Target::Swarm,
                };
                let robots = legs.iter().map(|(robot, _)| robot.clone());
                let mut record = Record::new(command, target, robots, now);
                for (robot, leg) in &legs {
                    if left == 0 {
                        stale.push((owed.id, robot.clone()));
                        continue;
                    }
                    if leg.seq != owed.id {
                        book.desk.numbers.insert(leg.seq, owed.id);
                        record.numbers.push(leg.seq);
                    }
                    let (delivery, flight) = (&mut book.delivery, (leg.seq, leg.boot));
                    delivery.resume(owed.id, robot, class, flight, (at, at + left));
                    if let Some(shared) = &mut book.desk.shared {
                        shared.owe_one(owed.id, robot.clone(), leg.seq, leg.boot);
                    }
                }
                if left > 0 {
                    book.desk.outcomes += record.outcomes.len();
                    book.desk.open.insert(owed.id);
                    book.desk.records.insert(owed.id, record);
                }
            }
            let commands = book.delivery.len();
            if commands > 0 {
                tracing::info!(commands, "commands of the last run to deliver");
            }
            book.desk.journal = Some(journal);
            for (id, robot) in stale {
                book.desk.done(id, &robot);
            }
        }
        self
    }
}
