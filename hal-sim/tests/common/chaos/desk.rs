//! The server's desk: what was given, and what goes out.

use std::collections::{BTreeMap, BTreeSet};

use crawler_delivery::{Class, End, Ms, Post, SETTINGS, Sending};
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

/// The desk of the server, apart from its delivery.
pub(super) struct Desk {
    pub(super) number: u64,
    pub(super) given: BTreeMap<u64, Given>,
    pub(super) numbers: BTreeMap<u64, u64>,
    pub(super) journal: BTreeMap<u64, Kept>,
    pub(super) sent: u64,
    pub(super) again: u64,
}

impl Desk {
    /// Halts wait for no disk, so a server that is killed knows nothing of those that are not over.
    pub(super) fn forget_halts(&mut self) {
        for given in self.given.values_mut() {
            let over = given.end.is_some() || given.answered.is_some();
            given.forgotten |= given.class == Class::Halt && !over;
        }
    }
}

pub(super) struct Clerk<'a> {
    pub(super) desk: &'a mut Desk,
    pub(super) simulation: &'a mut Simulation,
    pub(super) topics: &'a BTreeMap<RobotId, String>,
}

impl Post for Clerk<'_> {
    fn number(&mut self, _: u64, _: &RobotId, _: u64) -> u64 {
        self.desk.number += 1;
        self.desk.number
    }

    fn send(&mut self, sending: &Sending<'_>) -> bool {
        let given = &self.desk.given[&sending.id];
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
        if let Some(kept) = self.desk.journal.get_mut(&sending.id) {
            kept.seq = sending.seq;
            kept.boot = sending.boot;
        }
        self.desk.numbers.insert(sending.seq, sending.id);
        self.desk.sent += 1;
        self.desk.again += u64::from(sending.again);
        let mut buffer = [0; MAX_MESSAGE];
        let len = command.to_json(&mut buffer).unwrap();
        let topic = &self.topics[sending.robot];
        self.simulation.publish(topic, &buffer[..len], true, false);
        true
    }

    fn over(&mut self, id: u64, _: &RobotId, end: End) {
        self.desk.journal.remove(&id);
        self.desk.given.get_mut(&id).unwrap().end = Some(end);
    }
}
