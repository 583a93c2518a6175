//! Sending commands: numbered, written down, handed to the delivery.

use std::time::Instant;

use crawler_delivery::{Class, Ms};
use crawler_protocol::{Action, Command, MAX_MESSAGE, RobotId, Source, Topic};

use super::driver::write;
use super::journal::{JournalEntry, Refused, Ticket};
use super::shared::fields;
use super::{Book, CommandCenter, CommandView, Record, SendError, Target};
use crawler_cluster::ClusterMembership;
use crawler_metrics::Dropped;
use crawler_system::clock;

/// A command that the other servers were told of and nobody else was. Taken back when dropped.
struct Announcement<'a> {
    center: &'a CommandCenter,
    id: Option<u64>,
}

impl Announcement<'_> {
    fn keep(mut self) {
        self.id = None;
    }
}

impl Drop for Announcement<'_> {
    fn drop(&mut self) {
        if let Some(id) = self.id
            && let Some(shared) = &mut self.center.book().table.shared
        {
            shared.retract(id);
        }
    }
}

/// A command that was sent, or is held.
struct Given {
    view: CommandView,
    /// Tells when it is on the disk, if that is where it is to be.
    ticket: Option<Ticket>,
    /// Name of its record.
    id: u64,
}

/// Whether a command can be written down, if it is to be.
fn check_journal(book: &Book, class: Class, robots: usize) -> Result<(), SendError> {
    let (Class::Plain | Class::Setting, Some(journal)) = (class, &book.table.journal) else {
        return Ok(());
    };
    journal.check(robots).map_err(|refused| match refused {
        Refused::Failing => SendError::NotWritten { sent: false },
        Refused::Full => SendError::Full,
    })
}

impl CommandCenter {
    /// Sends somebody's command, or the server's own, and has it written down: in the journal what is to
    /// outlive this server, and where the other servers find it, if there are any. Returns when that
    /// is safe. Halts and motion wait for no disk.
    ///
    /// # Errors
    /// [`SendError`]; nothing has gone out then, and nothing will, but for what says that it was sent:
    /// a command may be with its robot before the disk has failed, and halts always go first.
    ///
    /// # Cancellation safety
    /// Dropped half way, the command does not go, or has gone whole. Nobody else's is delayed. One that
    /// cannot be written down may be followed all the same until this server ends.
    pub async fn give(
        &self,
        source: Option<Source>,
        action: Action,
        target: Target,
        expected: Vec<RobotId>,
    ) -> Result<CommandView, SendError> {
        let source = source.unwrap_or_else(|| self.source.clone());
        let Some(membership) = &self.membership else {
            let given = self.send_as(source, action, target, expected, Instant::now())?;
            return self.written_down(given).await;
        };
        if Class::of(&action) == Class::Halt {
            return self
                .halt(membership, source, action, target, expected)
                .await;
        }
        let turn = self.turn.lock().await;
        if !membership.is_member() {
            return Err(SendError::NotShared { sent: false });
        }
        if Class::of(&action) != Class::Setting && !self.outlet.is_up() {
            return Err(SendError::NotConnected);
        }
        let (command, fields) = {
            let mut book = self.book();
            let book = &mut *book;
            // Before the others are told.
            check_journal(book, Class::of(&action), expected.len())?;
            let command = Command {
                action,
                timestamp: self.time.now_ms(),
                seq: book.table.sequence.take(),
                source,
            };
            let settings = book.table.shared.as_ref();
            let settings = settings.and_then(|shared| shared.settings.as_ref());
            let boots = expected.iter();
            let boots = boots.map(|robot| (robot, book.delivery.boot(robot)));
            let fields = fields(&command, target == Target::Swarm, settings, boots);
            (command, fields.ok_or(SendError::TooLarge)?)
        };
        let announcement = Announcement {
            center: self,
            id: Some(command.seq),
        };
        let told = membership.cluster.accept(command.seq, &fields).await;
        let greatest = told.map_err(|error| {
            tracing::warn!(%error, "a command cannot be shared");
            SendError::NotShared { sent: false }
        })?;
        let given = {
            let mut book = self.book();
            book.table.sequence.above(greatest);
            self.dispatch(&mut book, command, target, expected, Instant::now())?
        };
        announcement.keep();
        // Nobody waits for the disk because of somebody else's command.
        drop(turn);
        self.written_down(given).await
    }

    /// Returns when a command that was sent is safe on the disk, where it is to be.
    async fn written_down(&self, given: Given) -> Result<CommandView, SendError> {
        let Given { view, ticket, id } = given;
        let safe = match ticket {
            Some(ticket) => ticket.safe().await,
            None => true,
        };
        if safe {
            Ok(view)
        } else {
            Err(self.take_back(id))
        }
    }

    /// Takes back a command that cannot be written down, unless it has gone.
    fn take_back(&self, id: u64) -> SendError {
        let mut book = self.book();
        let book = &mut *book;
        let Some(record) = book.table.records.get(&id) else {
            // Answered and forgotten, or another server's by now.
            return SendError::NotWritten { sent: true };
        };
        if !record.outcomes.keys().all(|robot| record.waited(robot)) {
            // Whoever has it answers it, and whoever does not may still get it.
            return SendError::NotWritten { sent: true };
        }
        let robots: Vec<RobotId> = record.outcomes.keys().cloned().collect();
        for robot in &robots {
            book.delivery.withdraw(id, robot);
            book.table.done(id, robot);
        }
        book.table.records.remove(&id);
        book.table.open.remove(&id);
        book.table.outcomes -= robots.len();
        book.sent -= robots.len() as u64;
        if let Some(shared) = &mut book.table.shared {
            shared.forget(id);
            shared.retract(id);
        }
        SendError::NotWritten { sent: false }
    }

    /// A halt goes first and is written down then.
    async fn halt(
        &self,
        membership: &ClusterMembership,
        source: Source,
        action: Action,
        target: Target,
        expected: Vec<RobotId>,
    ) -> Result<CommandView, SendError> {
        let view = self
            .send_as(source, action, target, expected, Instant::now())?
            .view;
        let fields = {
            let mut book = self.book();
            let book = &mut *book;
            let shared = book.table.shared.as_ref();
            let record = book.table.records.get(&view.seq);
            let fields = shared
                .zip(record)
                .and_then(|(shared, record)| shared.all(record));
            // One that was answered and forgotten in the meantime.
            let Some(fields) = fields else {
                return Ok(view);
            };
            fields
        };
        match membership.cluster.accept(view.seq, &fields).await {
            Ok(greatest) => {
                let mut book = self.book();
                book.table.sequence.above(greatest);
                // Answers that came before it was there.
                if let Some(shared) = &mut book.table.shared {
                    shared.touch_all(view.seq);
                }
                Ok(view)
            }
            Err(error) => {
                tracing::warn!(%error, "a halt cannot be shared");
                Err(SendError::NotShared { sent: true })
            }
        }
    }

    /// Sends one robot a command of the server's own that nothing depends on: it goes once, is not written down or
    /// followed, and nobody is told of it. Under a `source` that no other commands go under it is in the way of none.
    /// Returns its number, under which the robot answers.
    ///
    /// # Errors
    /// [`SendError`]; nothing has gone out then.
    pub fn ask(
        &self,
        source: Source,
        action: Action,
        robot: &RobotId,
        within_ms: Ms,
    ) -> Result<u64, SendError> {
        if !self.outlet.is_up() {
            return Err(SendError::NotConnected);
        }
        // The robot takes the commands of one source in the order of their numbers, so they go under one lock.
        let mut book = self.book();
        let command = Command {
            action,
            timestamp: self.time.now_ms(),
            seq: book.table.sequence.take(),
            source,
        };
        let mut buffer = [0; MAX_MESSAGE];
        let length = write(&command, &mut buffer)?;
        let payload = buffer.get(..length).unwrap_or_default();
        let topic = Topic::CommandRobot(robot.clone());
        self.outlet.publish(&topic, payload, within_ms)?;
        Ok(command.seq)
    }

    /// Sends a command of the server's own; see [`Self::send_as`].
    ///
    /// # Errors
    /// [`SendError`]; nothing has gone out then, and nothing will.
    #[cfg(test)]
    pub fn send(
        &self,
        action: Action,
        target: Target,
        expected: impl IntoIterator<Item = RobotId>,
        now: Instant,
    ) -> Result<CommandView, SendError> {
        let given = self.send_as(self.source.clone(), action, target, expected, now)?;
        if given.ticket.is_none_or(Ticket::wait) {
            Ok(given.view)
        } else {
            Err(self.take_back(given.id))
        }
    }

    /// Sends somebody's command, or holds it for a robot that is away, and remembers whose answers it
    /// waits for. It may not be on the disk yet.
    ///
    /// # Errors
    /// [`SendError`]; nothing has gone out then, and nothing will.
    fn send_as(
        &self,
        source: Source,
        action: Action,
        target: Target,
        expected: impl IntoIterator<Item = RobotId>,
        now: Instant,
    ) -> Result<Given, SendError> {
        let class = Class::of(&action);
        // Whoever steers must know that nobody hears. A setting can wait.
        if class != Class::Setting && !self.outlet.is_up() {
            return Err(SendError::NotConnected);
        }
        // Number and publish under one lock: a robot takes commands of one source only in the
        // order of their numbers. Answers wait for the same lock, so none can come too early.
        let mut book = self.book();
        let book = &mut *book;
        let command = Command {
            action,
            timestamp: self.time.now_ms(),
            seq: book.table.sequence.peek(),
            source,
        };
        self.dispatch(book, command, target, expected, now)
    }

    /// Sends a command that has its number; see [`Self::send_as`].
    fn dispatch(
        &self,
        book: &mut Book,
        command: Command,
        target: Target,
        expected: impl IntoIterator<Item = RobotId>,
        now: Instant,
    ) -> Result<Given, SendError> {
        let (seq, class) = (command.seq, Class::of(&command.action));
        let mut buffer = [0; MAX_MESSAGE];
        let length = write(&command, &mut buffer)?;
        let mut record = Record::new(command, target, expected, now);
        let robots: Vec<RobotId> = record.outcomes.keys().cloned().collect();
        check_journal(book, class, robots.len())?;
        // Settings go to each robot by itself, so that none is overtaken.
        let at_once = record.target == Target::Swarm && class != Class::Setting;
        if at_once {
            let payload = buffer.get(..length).unwrap_or_default();
            self.outlet
                .publish(&Topic::CommandSwarm, payload, class.life_ms())?;
        }
        if let Some(shared) = &book.table.shared {
            record.settings.clone_from(&shared.settings);
        }
        let at = self.ms(now);
        if at_once {
            record.went_to_all(now);
            book.delivery
                .broadcast(seq, robots.iter().cloned(), class, at);
        } else {
            for robot in &robots {
                if book.delivery.submit(seq, robot, class, at).is_err() {
                    for robot in &robots {
                        book.delivery.withdraw(seq, robot);
                    }
                    self.metrics.dropped(Dropped::CommandsFull);
                    return Err(SendError::Full);
                }
            }
        }
        book.table.sequence.used(seq);
        if let Some(shared) = &mut book.table.shared {
            let legs = robots.iter();
            shared.owe(
                seq,
                legs.map(|robot| (robot.clone(), book.delivery.boot(robot))),
            );
        }
        let mut ticket = None;
        if let (Class::Plain | Class::Setting, Some(journal)) = (class, &mut book.table.journal) {
            let legs = robots.iter();
            let legs = legs.map(|robot| (robot.clone(), book.delivery.boot(robot)));
            let expires = clock::unix_ms().saturating_add(class.life_ms());
            if let Some(owed) = JournalEntry::new(&record, expires, legs) {
                ticket = journal.accepted(owed);
            }
        }
        let action = record.command.action.name();
        book.table.outcomes += robots.len();
        book.table.records.insert(seq, record);
        book.table.open.insert(seq);
        let mut driver = self.driver(&mut book.table, now);
        if !at_once {
            for robot in &robots {
                book.delivery.poll_one(robot, at, &mut driver);
            }
        }
        // A robot that was to be told at once, and could not.
        let refused = driver.refused.filter(|_| class != Class::Setting);
        if let (Some(error), [robot]) = (refused, robots.as_slice())
            && book
                .table
                .records
                .get(&seq)
                .is_some_and(|record| record.waited(robot))
        {
            book.delivery.withdraw(seq, robot);
            book.table.done(seq, robot);
            book.table.records.remove(&seq);
            book.table.open.remove(&seq);
            book.table.outcomes -= 1;
            book.table.sequence.take_back(seq);
            return Err(error.into());
        }
        self.metrics.command_sent(action, robots.len());
        book.sent += robots.len() as u64;
        let view = book.table.records.get(&seq).map(Record::view);
        book.table.forget(&mut book.delivery, now);
        let view = view.ok_or(SendError::Full)?;
        let id = seq;
        Ok(Given { view, ticket, id })
    }
}
