//! Commands on their way: numbered, sent, sent again where no answer came, held for robots that
//! are away, and followed until every robot has answered for good.
//!
//! When a command goes to a robot is `crawler-delivery`'s to decide; what it has decided is carried out
//! here, and what robots are owed outlives this server: in a journal on disk, or in Redis.
//!
//! Reading order: `record` is a command and what it came to, `sequence` where its number comes from.
//! `send` accepts it, `driver` carries out what delivery decides, `list` tells what was sent lately.
//! `pending` is a command that robots are owed as both stores have it: `journal` on disk, which `resume`
//! goes on with after a start, and `shared` in Redis, which `cluster` joins to the rest.

mod cluster;
#[cfg(test)]
mod cluster_tests;
mod driver;
#[cfg(test)]
mod held_tests;
mod journal;
mod list;
mod pending;
mod record;
mod resume;
mod send;
mod sequence;
mod shared;
#[cfg(test)]
mod slow_disk_tests;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_delivery::{Class, Delivery, Ms};
use crawler_protocol::open::Response;
#[cfg(test)]
use crawler_protocol::{Action, Command};
use crawler_protocol::{MAX_MESSAGE, RobotId, Source, SwarmResponse, Topic};

use crawler_cluster::ClusterMembership;
use crawler_metrics::Metrics;
use crawler_system::clock::{self, FleetTime};

pub use cluster::view_of;
use driver::{CommandTable, DeliveryDriver};
pub use journal::Journal;
use record::Record;
pub use record::{CommandView, Counts, OutcomeStatus, OutcomeView};
pub use sequence::Sequence;
pub use shared::Change;

/// Commands remembered. Steering at seven commands a second fills this in ten minutes.
const MAX_RECORDS: usize = 4_096;
/// Outcomes remembered, of all commands together: ten swarm commands to the largest fleet.
const MAX_OUTCOMES: usize = 200_000;
/// And nothing longer than this.
const MAX_AGE: Duration = Duration::from_hours(1);

/// Whom a command is for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// One robot.
    Robot(RobotId),
    /// All of them.
    Swarm,
}

/// Why a command did not go out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SendError {
    /// There is no connection to the broker.
    NotConnected,
    /// Too much is waiting to go out.
    Full,
    /// The command does not fit a message.
    TooLarge,
    /// The other servers cannot be told: should this one fail, nobody would go on with it.
    NotShared {
        /// Whether it went to the robots all the same.
        sent: bool,
    },
    /// It cannot be written down: should the server end, nobody would go on with it.
    NotWritten {
        /// Whether it went to some robot before that was known.
        sent: bool,
    },
}

/// Why a message did not go out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PublishError {
    /// There is no connection to the broker.
    NotConnected,
    /// Too much is waiting already.
    Full,
}

/// What sending needs of the connection to the broker; a seam for tests.
pub trait Outlet: Send + Sync {
    /// Whether there is a connection to the broker.
    fn is_up(&self) -> bool;
    /// Hands one message to the connection. What is not retained is worth nothing `within_ms` later.
    ///
    /// # Errors
    /// [`PublishError`]; the message has not gone out then.
    fn publish(&self, topic: &Topic, payload: &[u8], within_ms: Ms) -> Result<(), PublishError>;
}

/// All commands of this server.
pub struct CommandCenter {
    outlet: Arc<dyn Outlet>,
    metrics: Arc<Metrics>,
    source: Source,
    /// The time that commands carry.
    pub time: FleetTime,
    /// Where the time of deliveries begins.
    start: Instant,
    book: Mutex<Book>,
    /// The other servers, where there are any.
    membership: Option<Arc<ClusterMembership>>,
    /// Held while a command is written down for them: they go in the order of their numbers.
    turn: tokio::sync::Mutex<()>,
}

struct Book {
    delivery: Delivery,
    table: CommandTable,
    sent: u64,
    answered: u64,
}

/// How many commands went out and how many were answered, counted per robot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Totals {
    /// Sent.
    pub sent: u64,
    /// Answered for good.
    pub answered: u64,
    /// Commands, not robots, that are under way.
    pub open: usize,
}

impl CommandCenter {
    /// Of a server that is alone and writes nothing down. Commands of its own are from `source`, and
    /// numbers are those of `sequence`.
    pub fn new(
        outlet: Arc<dyn Outlet>,
        metrics: Arc<Metrics>,
        source: Source,
        sequence: Sequence,
    ) -> Self {
        let table = CommandTable {
            sequence,
            records: BTreeMap::new(),
            open: BTreeSet::new(),
            numbers: BTreeMap::new(),
            outcomes: 0,
            journal: None,
            shared: None,
            over: Vec::new(),
        };
        Self {
            outlet,
            metrics,
            source,
            time: FleetTime::default(),
            start: Instant::now(),
            book: Mutex::new(Book {
                delivery: Delivery::new(),
                table,
                sent: 0,
                answered: 0,
            }),
            membership: None,
            turn: tokio::sync::Mutex::new(()),
        }
    }

    fn ms(&self, now: Instant) -> Ms {
        let since = now.saturating_duration_since(self.start);
        u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
    }

    fn driver<'a>(&'a self, table: &'a mut CommandTable, now: Instant) -> DeliveryDriver<'a> {
        DeliveryDriver {
            center: self,
            table,
            now,
            refused: None,
        }
    }

    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in an answer. One that names another source than that of the command of its number is somebody else's;
    /// robots before that name none, and are taken at the number. `known` says whether the fleet knows the robot: of a swarm command,
    /// answers of robots that were not expected count as well, but not of just anybody.
    ///
    /// Returns the command when this answer was the last one it waited for.
    pub fn answer(&self, response: &Response, known: bool, now: Instant) -> Option<CommandView> {
        let mut book = self.book();
        let book = &mut *book;
        let robot = &response.robot;
        if book.table.is_of_another(response) {
            return None;
        }
        let id = if let Some(id) = book.delivery.answered(robot, response.seq) {
            book.table.done(id, robot);
            id
        } else {
            let known = book.table.numbers.get(&response.seq);
            known.copied().unwrap_or(response.seq)
        };
        // An answer makes way for what waits behind the command.
        let at = self.ms(now);
        let mut driver = self.driver(&mut book.table, now);
        book.delivery.poll_one(robot, at, &mut driver);
        let Some(record) = book.table.records.get_mut(&id) else {
            if let Some(shared) = &mut book.table.shared {
                // Another server's, and perhaps ours before long.
                shared.heard(response);
            }
            return None;
        };
        let before = record.outcomes.len();
        let change = record.answer(response, known)?;
        if let Some(shared) = &mut book.table.shared {
            shared.touch(id, robot);
        }
        book.table.outcomes += record.outcomes.len() - before;
        if change.first_final {
            book.answered += 1;
            let outcome = OutcomeStatus::from(response.status);
            self.metrics.answer(outcome.name());
            if change.completed {
                let took = now.saturating_duration_since(record.sent_at);
                self.metrics.completed(record.command.action.name(), took);
            }
        }
        if record.is_open() {
            // Also when a robot that had been given up accepts after all.
            book.table.open.insert(id);
            return None;
        }
        if !book.table.open.remove(&id) {
            return None;
        }
        let view = record.view();
        self.announce(record);
        Some(view)
    }

    /// A robot has told its status, or its broker that it is gone. What is held for it goes now.
    pub fn status(&self, robot: &RobotId, online: bool, boot: u32, now: Instant) {
        let mut book = self.book();
        let book = &mut *book;
        let at = self.ms(now);
        book.delivery.status(robot, online, boot, at);
        let mut driver = self.driver(&mut book.table, now);
        book.delivery.poll_one(robot, at, &mut driver);
    }

    /// A robot has spoken.
    pub fn heard(&self, robot: &RobotId, now: Instant) {
        let at = self.ms(now);
        self.book().delivery.heard(robot, at);
    }

    /// The connection to the broker is there, or lost. What robots are owed goes with the next
    /// [`CommandCenter::sweep`].
    pub fn connection(&self, up: bool, now: Instant) {
        let at = self.ms(now);
        self.book().delivery.connection(up, at);
    }

    /// Sends what is due, gives up on what is overdue, and forgets what is old. Returns the commands
    /// that are over because of it.
    pub fn sweep(&self, now: Instant) -> Vec<CommandView> {
        let mut book = self.book();
        let book = &mut *book;
        let at = self.ms(now);
        let mut driver = self.driver(&mut book.table, now);
        book.delivery.poll(at, &mut driver);
        let mut over = mem::take(&mut book.table.over);
        let open: Vec<u64> = book.table.open.iter().copied().collect();
        for id in open {
            let Some(record) = book.table.records.get_mut(&id) else {
                book.table.open.remove(&id);
                continue;
            };
            let expired = record.expire(now);
            for _ in 0..expired {
                self.metrics.answer(OutcomeStatus::Timeout.name());
            }
            if let Some(shared) = &mut book.table.shared
                && expired > 0
            {
                for robot in record.outcomes.keys() {
                    shared.touch(id, robot);
                }
            }
            if !record.is_open() {
                book.table.open.remove(&id);
                over.push(record.view());
                self.announce(record);
            }
        }
        book.table.forget(&mut book.delivery, now);
        over
    }

    /// Publishes what a swarm command came to.
    fn announce(&self, record: &Record) {
        if record.target != Target::Swarm {
            return;
        }
        let response = SwarmResponse {
            source: record.command.source.clone(),
            seq: record.id,
            command: record.command.action.command(),
            robots: record.outcomes.len() as u32,
            outcomes: record.wire_outcomes(),
            timestamp: clock::unix_ms(),
        };
        let mut buffer = [0; MAX_MESSAGE];
        match response.to_json(&mut buffer) {
            Ok(length) => {
                let payload = buffer.get(..length).unwrap_or_default();
                let kept = Class::Halt.life_ms();
                if let Err(error) = self.outlet.publish(&Topic::ResponseSwarm, payload, kept) {
                    tracing::warn!(?error, seq = record.command.seq, "a swarm response is lost");
                }
            }
            Err(error) => tracing::error!(?error, "a swarm response cannot be written"),
        }
    }

    /// The command with the number `seq`, while it is remembered.
    pub fn view(&self, seq: u64) -> Option<CommandView> {
        self.book().table.records.get(&seq).map(Record::view)
    }

    /// See [`Totals`].
    pub fn totals(&self) -> Totals {
        let book = self.book();
        Totals {
            sent: book.sent,
            answered: book.answered,
            open: book.table.open.len(),
        }
    }
}

impl From<PublishError> for SendError {
    fn from(error: PublishError) -> Self {
        match error {
            PublishError::NotConnected => Self::NotConnected,
            PublishError::Full => Self::Full,
        }
    }
}
