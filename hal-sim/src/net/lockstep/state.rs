//! The network between two events: its links, its connections and what is to happen to them.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::task::Waker;

use rand_core::Rng;
use rand_pcg::Pcg32;

use super::packet::{self, Publication};
use super::peer::{Client, Output, Peer, PeerFault};
use super::pipe::{HELD, Pipe};
use super::{Cut, LinkModel};

/// Bytes the broker may have under way to a robot before it gives the connection up.
const MAX_BACKLOG: usize = 256 * 1024;

/// One robot's way to the broker.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) cut: Cut,
    pub(super) rng: Pcg32,
    /// Woken when the link heals.
    pub(super) waiting: Option<Waker>,
}

/// What became of the robot's end of a connection.
#[derive(Debug)]
pub(super) struct Connection {
    /// Tells it from an earlier one in the same place.
    serial: u64,
    pub(super) link: usize,
    pub(super) up: Pipe,
    pub(super) down: Pipe,
    /// What arrived from the robot and is no whole packet yet.
    pending: Vec<u8>,
    client: Option<Client>,
    /// When the broker heard something last.
    heard: u64,
    /// The robot dropped its end.
    pub(super) abandoned: bool,
    /// The broker is done with it.
    pub(super) closed: bool,
}

/// Something the network does by itself, in order of time and then of cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Event {
    /// Bytes of this connection arrive at the broker.
    Arrival(usize),
    /// The end of this connection arrives at the broker.
    End(usize),
    /// The broker looks whether this connection is still alive.
    Patience(usize, u64),
    /// The broker looks for sessions that ended.
    Expiry,
    /// The server tells the time.
    Time,
}

pub(super) struct State {
    pub(super) model: LinkModel,
    pub(super) links: Vec<Link>,
    pub(super) connections: Vec<Option<Connection>>,
    pub(super) peer: Peer,
    pub(super) events: BinaryHeap<Reverse<(u64, u64, Event)>>,
    pub(super) arrivals: u64,
    /// Connections ever opened.
    pub(super) opened: u64,
    /// When the network task is going to wake.
    pub(super) armed: u64,
    /// Wakes the network task when something is to happen earlier.
    pub(super) kick: Option<Waker>,
    pub(super) time: Option<TimeService>,
    /// For reading packets out of a connection while it is borrowed.
    pub(super) scratch: Vec<u8>,
}

pub(super) struct TimeService {
    pub(super) topic: String,
    pub(super) every_us: u64,
    pub(super) epoch_ms: u64,
}

impl State {
    pub(super) fn schedule(&mut self, at: u64, event: Event) {
        self.events.push(Reverse((at, self.arrivals, event)));
        self.arrivals += 1;
        if at < self.armed {
            self.armed = 0;
            if let Some(waker) = self.kick.take() {
                waker.wake();
            }
        }
    }

    /// Draws how long one segment takes.
    pub(super) fn delay(&mut self, link: usize) -> u64 {
        let model = self.model;
        let rng = &mut self.links[link].rng;
        let mut draw = || (rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0);
        let mut ms = model.latency_ms + model.jitter_ms * draw();
        if model.loss > 0.0 {
            let mut again = model.retransmit_ms;
            while draw() < model.loss && again < 60_000.0 {
                ms += again;
                again *= 2.0;
            }
        }
        (ms * 1_000.0) as u64
    }

    pub(super) fn arrival(&mut self, link: usize, now: u64) -> u64 {
        if self.links[link].cut == Cut::None {
            now + self.delay(link)
        } else {
            HELD
        }
    }

    pub(super) fn open(&mut self, link: usize, now: u64) -> usize {
        self.opened += 1;
        let connection = Connection {
            serial: self.opened,
            link,
            up: Pipe::default(),
            down: Pipe::default(),
            pending: Vec::new(),
            client: None,
            heard: now,
            abandoned: false,
            closed: false,
        };
        let vacant = self.connections.iter().position(Option::is_none);
        let index = vacant.unwrap_or(self.connections.len());
        if vacant.is_none() {
            self.connections.push(None);
        }
        self.connections[index] = Some(connection);
        index
    }

    /// The robot's bytes reach the broker.
    pub(super) fn arrive(&mut self, index: usize, now: u64) {
        let Some(Some(connection)) = self.connections.get_mut(index) else {
            return;
        };
        if connection.closed || self.links[connection.link].cut != Cut::None {
            return;
        }
        let before = connection.pending.len();
        connection.up.read_to(now, &mut connection.pending);
        if connection.pending.len() == before {
            return;
        }
        connection.heard = now;
        let mut bytes = std::mem::take(&mut self.scratch);
        std::mem::swap(&mut bytes, &mut connection.pending);
        let mut client = connection.client.take();
        let greeted = client.is_some();
        let mut out = Output::default();
        let mut used = 0;
        let fault = loop {
            match packet::frame_len(&bytes[used..]) {
                Ok(Some(len)) if len <= bytes.len() - used => {
                    let frame = &bytes[used..used + len];
                    let result = self.peer.receive(index, &mut client, frame, now, &mut out);
                    used += len;
                    if let Err(fault) = result {
                        break Some(fault);
                    }
                    if out.close.contains(&index) {
                        break None;
                    }
                }
                Ok(_) => break None,
                Err(error) => break Some(PeerFault::Packet(error)),
            }
        };
        if let Some(Some(connection)) = self.connections.get_mut(index) {
            connection.pending.extend_from_slice(&bytes[used..]);
            connection.client = client;
        }
        bytes.clear();
        self.scratch = bytes;
        if !greeted {
            self.watch(index, now);
        }
        if let Some(fault) = fault {
            self.fail(index, fault, &mut out);
        }
        self.carry_out(out, now);
    }

    /// Looks after the keep-alive of a connection that has just been accepted.
    fn watch(&mut self, index: usize, now: u64) {
        if let Some(Some(connection)) = self.connections.get(index)
            && let Some(client) = &connection.client
        {
            let (patience, serial) = (Peer::patience(client), connection.serial);
            if patience > 0 {
                self.schedule(now + patience, Event::Patience(index, serial));
            }
        }
    }

    pub(super) fn check_patience(&mut self, index: usize, serial: u64, now: u64) {
        let Some(Some(connection)) = self.connections.get(index) else {
            return;
        };
        if connection.serial != serial {
            return;
        }
        let Some(client) = &connection.client else {
            return;
        };
        let due = connection.heard + Peer::patience(client);
        if due > now {
            self.schedule(due, Event::Patience(index, serial));
            return;
        }
        let mut out = Output::default();
        self.fail(index, PeerFault::KeepAlive, &mut out);
        self.carry_out(out, now);
    }

    fn fail(&mut self, index: usize, fault: PeerFault, out: &mut Output) {
        if let Some(Some(connection)) = self.connections.get(index) {
            self.peer
                .closed_for(index, connection.client.as_ref(), fault, out);
            out.close.push(index);
        }
    }

    /// Sends what the broker wants sent, and closes what it wants closed.
    pub(super) fn carry_out(&mut self, mut out: Output, now: u64) {
        // A will may be due to someone, whose answer is bytes only: two rounds at the very most
        // for each connection that closes, and every round closes at least one.
        loop {
            for (index, bytes) in std::mem::take(&mut out.bytes) {
                let Some(Some(connection)) = self.connections.get(index) else {
                    continue;
                };
                if connection.closed || connection.abandoned {
                    continue;
                }
                let (link, backlog) = (connection.link, connection.down.len());
                if backlog + bytes.len() > MAX_BACKLOG {
                    self.fail(index, PeerFault::TooSlow, &mut out);
                    continue;
                }
                let arrival = self.arrival(link, now);
                if let Some(Some(connection)) = self.connections.get_mut(index) {
                    connection.down.write(&bytes, arrival);
                }
            }
            if out.close.is_empty() && out.bytes.is_empty() {
                return;
            }
            for index in std::mem::take(&mut out.close) {
                self.close(index, now, &mut out);
            }
        }
    }

    fn close(&mut self, index: usize, now: u64, out: &mut Output) {
        let Some(Some(connection)) = self.connections.get_mut(index) else {
            return;
        };
        if connection.closed {
            return;
        }
        connection.closed = true;
        connection.up.end();
        connection.down.end();
        let client = connection.client.take();
        if connection.abandoned {
            self.connections[index] = None;
        }
        if let Some(client) = client
            && let Some(expires) = self.peer.lost(index, client, now, out)
        {
            self.schedule(expires.max(now + 1), Event::Expiry);
        }
    }

    /// The end of the robot's stream reaches the broker.
    pub(super) fn end(&mut self, index: usize, now: u64) {
        let gone = matches!(self.connections.get(index), Some(Some(connection))
            if connection.abandoned && self.links[connection.link].cut == Cut::None);
        if gone {
            let mut out = Output::default();
            out.close.push(index);
            self.carry_out(out, now);
        }
    }

    /// The robot drops its end.
    pub(super) fn abandon(&mut self, index: usize, now: u64) {
        let Some(Some(connection)) = self.connections.get_mut(index) else {
            return;
        };
        connection.abandoned = true;
        connection.up.reader = None;
        connection.up.writer = None;
        if connection.closed {
            self.connections[index] = None;
            return;
        }
        let link = connection.link;
        let last = connection.up.next_arrival().map(|_| connection.up.last());
        if self.links[link].cut == Cut::None {
            // The end of the stream does not overtake its bytes.
            let arrival = (now + self.delay(link)).max(last.unwrap_or(0));
            self.schedule(arrival, Event::End(index));
        }
    }

    pub(super) fn tell_time(&mut self, now: u64) {
        let Some(service) = &self.time else {
            return;
        };
        let (topic, next) = (service.topic.clone(), now + service.every_us);
        let payload = format!(r#"{{"timestamp":{}}}"#, service.epoch_ms + now / 1_000);
        let message = Publication {
            topic: &topic,
            payload: payload.as_bytes(),
            at_least_once: false,
            retain: false,
        };
        let mut out = Output::default();
        self.peer.route(&message, &mut out);
        self.carry_out(out, now);
        self.schedule(next, Event::Time);
    }
}
