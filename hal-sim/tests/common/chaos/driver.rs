//! The server's part: what was given, and what goes out.

use std::collections::{BTreeMap, BTreeSet};

use crawler_delivery::{Class, DeliverySink, End, Ms, SETTINGS, Sending};
use crawler_protocol::{Action, Command, MAX_MESSAGE, ResponseStatus, RobotId, Source};
use crawler_sim::run::Simulation;

/// A command of the operator.
pub(super) struct Given {
    pub(super) robot: usize,
    pub(super) action: Action,
    pub(super) class: Class,
    pub(super) at: Ms,
    pub(super) timestamp: u64,
    pub(super) end: Option<End>,
    /// Numbers under which it ran.
    pub(super) ran: BTreeSet<u64>,
    pub(super) answered: Option<ResponseStatus>,
    /// The server was killed before it was over, and had not written it down.
    pub(super) forgotten: bool,
}

/// What survives the server.
#[derive(Clone, Copy)]
pub(super) struct Kept {
    pub(super) seq: u64,
    pub(super) boot: Option<u32>,
    pub(super) expires: Ms,
}

/// What the server remembers of commands, apart from their delivery.
pub(super) struct CommandTable {
    pub(super) number: u64,
    pub(super) given: BTreeMap<u64, Given>,
    pub(super) numbers: BTreeMap<u64, u64>,
    pub(super) journal: BTreeMap<u64, Kept>,
    pub(super) sent: u64,
    pub(super) again: u64,
}

impl CommandTable {
    /// Halts wait for no disk, so a server that is killed knows nothing of those that are not over.
    pub(super) fn forget_halts(&mut self) {
        for given in self.given.values_mut() {
            let over = given.end.is_some() || given.answered.is_some();
            given.forgotten |= given.class == Class::Halt && !over;
        }
    }
}

pub(super) struct DeliveryDriver<'a> {
    pub(super) table: &'a mut CommandTable,
    pub(super) simulation: &'a mut Simulation,
    pub(super) topics: &'a BTreeMap<RobotId, String>,
}

impl DeliverySink for DeliveryDriver<'_> {
    fn number(&mut self, _: u64, _: &RobotId, _: u64) -> u64 {
        self.table.number += 1;
        self.table.number
    }

    fn send(&mut self, sending: &Sending<'_>) -> bool {
        let given = &self.table.given[&sending.id];
        let timestamp = match given.class {
            Class::Motion => given.timestamp,
            _ => self.simulation.unix_ms(),
        };
        let command = Command {
            action: given.action.clone(),
            timestamp,
            seq: sending.seq,
            source: match given.class {
                Class::Setting => Source::new(SETTINGS).unwrap(),
                _ => Source::new("server").unwrap(),
            },
        };
        if let Some(kept) = self.table.journal.get_mut(&sending.id) {
            kept.seq = sending.seq;
            kept.boot = sending.boot;
        }
        self.table.numbers.insert(sending.seq, sending.id);
        self.table.sent += 1;
        self.table.again += u64::from(sending.again);
        let mut buffer = [0; MAX_MESSAGE];
        let len = command.to_json(&mut buffer).unwrap();
        let topic = &self.topics[sending.robot];
        self.simulation.publish(topic, &buffer[..len], true, false);
        true
    }

    fn over(&mut self, id: u64, _: &RobotId, end: End) {
        self.table.journal.remove(&id);
        self.table.given.get_mut(&id).unwrap().end = Some(end);
    }
}
