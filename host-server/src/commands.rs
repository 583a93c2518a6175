//! Commands on their way: numbered, sent, and followed until every robot has answered for good.

mod record;
mod sequence;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_protocol::{
    Action, Command, EncodeError, MAX_MESSAGE, Response, RobotId, Source, SwarmResponse, Topic,
};

use crate::bus::{Bus, PublishError};
use crate::clock;
use crate::metrics::Metrics;

pub(crate) use record::{CommandView, OutcomeStatus, Record};
pub(crate) use sequence::Sequence;

/// Commands remembered. Steering at seven commands a second fills this in ten minutes.
const MAX_RECORDS: usize = 4_096;
/// Outcomes remembered, of all commands together: ten swarm commands to the largest fleet.
const MAX_OUTCOMES: usize = 200_000;
/// And nothing longer than this.
const MAX_AGE: Duration = Duration::from_hours(1);

/// Whom a command is for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Target {
    Robot(RobotId),
    Swarm,
}

/// Why a command did not go out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SendError {
    /// There is no connection to the broker.
    NotConnected,
    /// Too much is waiting to go out.
    Full,
    /// The command does not fit a message.
    TooLarge,
}

/// What sending needs of the bus; a seam for tests.
pub(crate) trait Outlet: Send + Sync {
    /// See [`Bus::publish`].
    fn publish(&self, topic: &Topic, payload: &[u8]) -> Result<(), PublishError>;
}

impl Outlet for Bus {
    fn publish(&self, topic: &Topic, payload: &[u8]) -> Result<(), PublishError> {
        Self::publish(self, topic, payload)
    }
}

/// All commands of this server.
pub(crate) struct CommandCenter {
    outlet: Arc<dyn Outlet>,
    metrics: Arc<Metrics>,
    source: Source,
    book: Mutex<Book>,
}

struct Book {
    sequence: Sequence,
    records: BTreeMap<u64, Record>,
    open: BTreeSet<u64>,
    outcomes: usize,
    sent: u64,
    answered: u64,
}

/// How many commands went out and how many were answered, counted per robot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Totals {
    pub(crate) sent: u64,
    pub(crate) answered: u64,
    pub(crate) open: usize,
}

impl CommandCenter {
    pub(crate) fn new(
        outlet: Arc<dyn Outlet>,
        metrics: Arc<Metrics>,
        source: Source,
        sequence: Sequence,
    ) -> Self {
        Self {
            outlet,
            metrics,
            source,
            book: Mutex::new(Book {
                sequence,
                records: BTreeMap::new(),
                open: BTreeSet::new(),
                outcomes: 0,
                sent: 0,
                answered: 0,
            }),
        }
    }

    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a command and remembers whose answers it waits for.
    ///
    /// # Errors
    /// [`SendError`]; nothing has gone out then.
    pub(crate) fn send(
        &self,
        action: Action,
        target: Target,
        expected: impl IntoIterator<Item = RobotId>,
        now: Instant,
    ) -> Result<CommandView, SendError> {
        // Number and publish under one lock: a robot takes commands of one source only in the
        // order of their numbers. Answers wait for the same lock, so none can come too early.
        let mut book = self.book();
        let seq = book.sequence.peek();
        let command = Command {
            action,
            timestamp: clock::unix_ms(),
            seq,
            source: self.source.clone(),
        };
        let mut buffer = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buffer).map_err(|error| match error {
            EncodeError::TooLarge => SendError::TooLarge,
            error => {
                tracing::error!(?error, "a checked command cannot be written");
                SendError::TooLarge
            }
        })?;
        let topic = match &target {
            Target::Robot(id) => Topic::CommandRobot(id.clone()),
            Target::Swarm => Topic::CommandSwarm,
        };
        self.outlet
            .publish(&topic, buffer.get(..length).unwrap_or_default())
            .map_err(|error| match error {
                PublishError::NotConnected => SendError::NotConnected,
                PublishError::Full => SendError::Full,
            })?;
        book.sequence.advance();
        let record = Record::new(command, target, expected, now);
        let robots = record.outcomes.len();
        self.metrics
            .command_sent(record.command.action.name(), robots);
        let view = record.view();
        book.sent += robots as u64;
        book.outcomes += robots;
        book.records.insert(seq, record);
        book.open.insert(seq);
        book.forget(now);
        Ok(view)
    }

    /// Takes in an answer. `known` says whether the fleet knows the robot: of a swarm command,
    /// answers of robots that were not expected count as well, but not of just anybody.
    ///
    /// Returns the command when this answer was the last one it waited for.
    pub(crate) fn answer(
        &self,
        response: &Response,
        known: bool,
        now: Instant,
    ) -> Option<CommandView> {
        let mut book = self.book();
        let book = &mut *book;
        let record = book.records.get_mut(&response.seq)?;
        let before = record.outcomes.len();
        let change = record.answer(response, known)?;
        book.outcomes += record.outcomes.len() - before;
        if change.first_final {
            book.answered += 1;
            self.metrics.answer(response.status.name());
            if change.completed {
                let took = now.saturating_duration_since(record.sent_at);
                self.metrics.completed(record.command.action.name(), took);
            }
        }
        if record.is_open() {
            // Also when a robot that had been given up accepts after all.
            book.open.insert(response.seq);
            return None;
        }
        if !book.open.remove(&response.seq) {
            return None;
        }
        let view = record.view();
        self.announce(record);
        Some(view)
    }

    /// Gives up on answers that are overdue, and forgets what is old. Returns the commands that are
    /// over because of it.
    pub(crate) fn sweep(&self, now: Instant) -> Vec<CommandView> {
        let mut book = self.book();
        let book = &mut *book;
        let mut over = Vec::new();
        let open: Vec<u64> = book.open.iter().copied().collect();
        for seq in open {
            let Some(record) = book.records.get_mut(&seq) else {
                book.open.remove(&seq);
                continue;
            };
            for _ in 0..record.expire(now) {
                self.metrics.answer(OutcomeStatus::Timeout.name());
            }
            if !record.is_open() {
                book.open.remove(&seq);
                over.push(record.view());
                self.announce(record);
            }
        }
        book.forget(now);
        over
    }

    /// Publishes what a swarm command came to.
    fn announce(&self, record: &Record) {
        if record.target != Target::Swarm {
            return;
        }
        let response = SwarmResponse {
            source: record.command.source.clone(),
            seq: record.command.seq,
            command: record.command.action.command(),
            robots: record.outcomes.len() as u32,
            outcomes: record.wire_outcomes(),
            timestamp: clock::unix_ms(),
        };
        let mut buffer = [0; MAX_MESSAGE];
        match response.to_json(&mut buffer) {
            Ok(length) => {
                let payload = buffer.get(..length).unwrap_or_default();
                if let Err(error) = self.outlet.publish(&Topic::ResponseSwarm, payload) {
                    tracing::warn!(?error, seq = record.command.seq, "a swarm response is lost");
                }
            }
            Err(error) => tracing::error!(?error, "a swarm response cannot be written"),
        }
    }

    pub(crate) fn view(&self, seq: u64) -> Option<CommandView> {
        self.book().records.get(&seq).map(Record::view)
    }

    pub(crate) fn totals(&self) -> Totals {
        let book = self.book();
        Totals {
            sent: book.sent,
            answered: book.answered,
            open: book.open.len(),
        }
    }
}

impl Book {
    /// Drops the oldest records until the rest is within bounds.
    fn forget(&mut self, now: Instant) {
        while let Some(entry) = self.records.first_entry() {
            let record = entry.get();
            let old = now.saturating_duration_since(record.sent_at) > MAX_AGE;
            let many = self.outcomes > MAX_OUTCOMES;
            // One command always stays, however many robots it was for.
            if !old && !many && self.records.len() <= MAX_RECORDS || self.records.len() == 1 && !old
            {
                break;
            }
            if let Some((seq, record)) = self.records.pop_first() {
                self.outcomes -= record.outcomes.len();
                self.open.remove(&seq);
            }
        }
    }
}
