//! Carries out what the delivery decides: numbers, sends and closes commands.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use crawler_delivery::{Class, Delivery, DeliverySink, End, Sending};
use crawler_protocol::open::Response;
use crawler_protocol::{Command, EncodeError, MAX_MESSAGE, RobotId, Topic};

use super::journal::JournalQueue;
use super::pending::Store;
use super::record::Record;
use super::sequence::Sequence;
use super::shared::SharedTable;
use super::{CommandCenter, CommandView, MAX_AGE, MAX_OUTCOMES, MAX_RECORDS, SendError, Target};
use crate::PublishError;
use crawler_metrics::Dropped;

/// All commands that are remembered.
pub(super) struct CommandTable {
    pub(super) sequence: Sequence,
    pub(super) records: BTreeMap<u64, Record>,
    pub(super) open: BTreeSet<u64>,
    /// Whose command a number is that is not its id.
    pub(super) numbers: BTreeMap<u64, u64>,
    pub(super) outcomes: usize,
    pub(super) journal: Option<JournalQueue>,
    /// What other servers are told of it, where there are any.
    pub(super) shared: Option<SharedTable>,
    /// Commands that have come to their end and that nobody has been told of.
    pub(super) over: Vec<CommandView>,
}

impl CommandTable {
    /// Where it is kept what is to be delivered. The disk first: what is on it is told to other servers then.
    fn stores(&mut self) -> impl Iterator<Item = &mut dyn Store> {
        let journal = self
            .journal
            .iter_mut()
            .map(|journal| journal as &mut dyn Store);
        let shared = self
            .shared
            .iter_mut()
            .map(|shared| shared as &mut dyn Store);
        journal.chain(shared)
    }

    /// Whether an answer is to a command that somebody else gave under a number of ours.
    pub(super) fn is_of_another(&self, response: &Response) -> bool {
        let seq = response.seq;
        let id = self.numbers.get(&seq).copied().unwrap_or(seq);
        let record = self.records.get(&id);
        let (Some(record), Some(source)) = (record, &response.source) else {
            return false;
        };
        record.source() != *source
    }

    pub(super) fn done(&mut self, id: u64, robot: &RobotId) {
        for store in self.stores() {
            store.done(id, robot);
        }
    }

    /// Drops the oldest records until the rest is within bounds. Settings on their way stay: there
    /// is a bound for those.
    pub(super) fn forget(&mut self, delivery: &mut Delivery, now: Instant) {
        loop {
            let mut records = self.records.iter();
            let oldest = records.find(|(id, record)| {
                Class::of(&record.command.action) != Class::Setting || !self.open.contains(id)
            });
            let Some((&id, record)) = oldest else { return };
            let old = now.saturating_duration_since(record.sent_at) > MAX_AGE;
            let many = self.outcomes > MAX_OUTCOMES || self.records.len() > MAX_RECORDS;
            // One command always stays, however many robots it was for.
            if !old && (!many || self.records.len() == 1) {
                return;
            }
            if let Some(record) = self.records.remove(&id) {
                self.outcomes -= record.outcomes.len();
                if self.open.remove(&id) {
                    for robot in record.outcomes.keys() {
                        delivery.withdraw(id, robot);
                        self.done(id, robot);
                    }
                }
                for seq in record.numbers {
                    self.numbers.remove(&seq);
                }
            }
        }
    }
}

/// Writes a command.
pub(super) fn write(command: &Command, buffer: &mut [u8; MAX_MESSAGE]) -> Result<usize, SendError> {
    command.to_json(buffer).map_err(|error| {
        if error != EncodeError::TooLarge {
            tracing::error!(?error, "a checked command cannot be written");
        }
        SendError::TooLarge
    })
}

/// See the [module](self).
pub(super) struct DeliveryDriver<'a> {
    pub(super) center: &'a CommandCenter,
    pub(super) table: &'a mut CommandTable,
    pub(super) now: Instant,
    /// Why something could not go.
    pub(super) refused: Option<PublishError>,
}

impl DeliverySink for DeliveryDriver<'_> {
    fn number(&mut self, id: u64, robot: &RobotId, above: u64) -> u64 {
        let mut reserved = None;
        for store in self.table.stores() {
            // What other servers know counts before what is on this disk.
            reserved = store.reserved(id, robot, above).or(reserved);
        }
        match reserved {
            Some(seq) => seq,
            None => self.table.sequence.take(),
        }
    }

    fn may_go(&self, _: Class) -> bool {
        // Whoever has no lease may have lost its commands to another server.
        let membership = self.center.membership.as_ref();
        membership.is_none_or(|membership| membership.is_member())
    }

    fn send(&mut self, sending: &Sending<'_>) -> bool {
        let table = &mut *self.table;
        let renumbered = sending.seq != sending.id && !sending.again;
        let Sending {
            id,
            robot,
            seq,
            boot,
            ..
        } = *sending;
        // After a crash, or when another server takes over, it must not go under yet another. It goes with the next
        // poll after that is written down.
        if renumbered
            && !table
                .stores()
                .all(|store| store.may_go(id, robot, seq, boot))
        {
            return false;
        }
        let Some(record) = table.records.get_mut(&sending.id) else {
            // Forgotten, and nobody waits for it.
            return true;
        };
        let mut command = record.command.clone();
        command.seq = sending.seq;
        // Who gave it is in the record and in the audit log.
        command.source = record.source();
        // What waited is as new as its delivery; only motion must never be taken for newer than
        // it is.
        if Class::of(&command.action) != Class::Motion && record.waited(sending.robot) {
            command.timestamp = self.center.time.now_ms();
        }
        if renumbered {
            table.numbers.insert(sending.seq, sending.id);
            record.numbers.push(sending.seq);
        }
        let mut buffer = [0; MAX_MESSAGE];
        let Ok(length) = write(&command, &mut buffer) else {
            // It fitted with its first number. One that is a digit longer is centuries away.
            return true;
        };
        let topic = Topic::CommandRobot(sending.robot.clone());
        let payload = buffer.get(..length).unwrap_or_default();
        match self.center.outlet.publish(&topic, payload, sending.life_ms) {
            Ok(()) => {
                record.went(sending.robot, sending.seq, self.now);
                true
            }
            Err(error) => {
                self.refused = Some(error);
                false
            }
        }
    }

    fn over(&mut self, id: u64, robot: &RobotId, end: End) {
        self.table.done(id, robot);
        let Some(record) = self.table.records.get_mut(&id) else {
            return;
        };
        let Some(status) = record.over(robot, end) else {
            return;
        };
        self.center.metrics.answer(status.name());
        if end == End::Expired {
            self.center.metrics.dropped(Dropped::CommandExpired);
        }
        if !record.is_open() && self.table.open.remove(&id) {
            let view = record.view();
            if record.target == Target::Swarm {
                self.center.announce(record);
            }
            self.table.over.push(view);
        }
    }
}
