//! The network between two events: its links, its connections and what is to happen to them.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::task::Waker;

use rand_pcg::Pcg32;

use super::packet::{self, Publication};
use super::peer::{Carried, Client, Output, Peer, PeerFault, Place};
use super::pipe::{HELD, Pipe};
use super::{Cut, LinkModel, News};
use crate::net::radio::{Airtime, Direction, Medium, Reach};

/// Bytes the broker may have under way to a robot before it gives the connection up.
const MAX_BACKLOG: usize = 256 * 1024;

/// One robot's way to the broker.
#[derive(Debug)]
pub(super) struct Link {
    /// What was done to it.
    pub(super) cut: Cut,
    /// What the radio makes of it.
    pub(super) reach: Reach,
    /// The sum of both that its connections have felt.
    pub(super) applied: Cut,
    pub(super) rng: Pcg32,
    /// Woken when the link heals.
    pub(super) waiting: Option<Waker>,
}

impl Link {
    /// What is wrong with it, all in all.
    pub(super) const fn state(&self) -> Cut {
        self.reach.and(self.cut)
    }
}

/// What became of the robot's end of a connection.
#[derive(Debug)]
pub(super) struct Connection {
    /// Tells it from an earlier one in the same place.
    serial: u32,
    pub(super) link: usize,
    pub(super) up: Pipe,
    pub(super) down: Pipe,
    /// What arrived from the robot and is no whole packet yet.
    pending: Vec<u8>,
    pub(super) client: Option<Client>,
    /// When the broker heard something last.
    heard: u64,
    /// The robot dropped its end.
    pub(super) abandoned: bool,
    /// The broker is done with it.
    pub(super) closed: bool,
}

/// Something the network does by itself, in order of time and then of cause. Connections are told
/// by their place; there are some of these for each robot, so they are kept small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Event {
    /// Bytes of this connection arrive at the broker.
    Arrival(u32),
    /// The end of this connection arrives at the broker.
    End(u32),
    /// The broker looks whether this connection is still alive.
    Patience(u32, u32),
    /// The broker looks for sessions that ended.
    Expiry,
    /// The server tells the time.
    Time,
}

pub(super) struct State {
    pub(super) model: LinkModel,
    pub(super) radio: Option<Medium>,
    pub(super) links: Vec<Link>,
    pub(super) connections: Vec<Option<Connection>>,
    /// How many of these are none.
    pub(super) vacant: usize,
    pub(super) peer: Peer,
    /// By time, then by link, those of no link first, then by order of arrival: so what happens
    /// to one link does not depend on which others there are.
    pub(super) events: BinaryHeap<Reverse<(u64, u32, u64, Event)>>,
    pub(super) arrivals: u64,
    /// Connections ever opened.
    pub(super) opened: u32,
    pub(super) time: Option<TimeService>,
    /// What robots published and is to be handed on.
    pub(super) inbox: Vec<Carried>,
    /// What each radio channel saw in the window that has just ended.
    pub(super) airtime: Vec<Airtime>,
    /// Room for a report, kept from step to step.
    pub(super) news: News,
    /// For reading packets out of a connection while it is borrowed.
    pub(super) scratch: Vec<u8>,
    /// The broker is dead.
    pub(super) stopped: bool,
}

pub(super) struct TimeService {
    pub(super) topic: String,
    pub(super) every_us: u64,
    pub(super) epoch_ms: u64,
}

impl State {
    pub(super) fn schedule(&mut self, at: u64, link: Option<usize>, event: Event) {
        let link = link.map_or(0, |link| link as u32 + 1);
        self.events.push(Reverse((at, link, self.arrivals, event)));
        self.arrivals += 1;
    }

    /// Draws when `len` bytes sent now arrive.
    fn transit(&mut self, link: usize, direction: Direction, len: usize, now: u64) -> u64 {
        let rng = &mut self.links[link].rng;
        let Some(radio) = &mut self.radio else {
            return now + self.model.draw(self.model.loss, rng);
        };
        let sent = radio.send(link, direction, len, now);
        sent + self.model.draw(radio.loss(link), rng) + radio.spike(rng)
    }

    /// Draws how long something as short as a handshake takes.
    pub(super) fn delay(&mut self, link: usize, now: u64) -> u64 {
        self.transit(link, Direction::Up, 0, now) - now
    }

    /// When `len` bytes sent now arrive, if they do.
    pub(super) fn arrival(
        &mut self,
        link: usize,
        direction: Direction,
        len: usize,
        now: u64,
    ) -> u64 {
        if self.links[link].state() == Cut::None {
            self.transit(link, direction, len, now)
        } else {
            HELD
        }
    }

    /// Holds up what is under way on links that have been cut, and lets go what was on those that
    /// have healed.
    pub(super) fn relink(&mut self, now: u64) {
        let mut changed: Vec<(usize, u32, usize)> = Vec::new();
        for (index, connection) in self.connections.iter().enumerate() {
            if let Some(connection) = connection {
                let link = &self.links[connection.link];
                if (link.applied == Cut::None) != (link.state() == Cut::None) {
                    changed.push((connection.link, connection.serial, index));
                }
            }
        }
        // Which place a connection has depends on those of other links. Its age does not.
        changed.sort_unstable();
        for (_, _, index) in changed {
            let Some(connection) = &mut self.connections[index] else {
                continue;
            };
            let was = self.links[connection.link].applied == Cut::None;
            if was {
                // The broker reads at once, so whatever is left has not arrived.
                connection.up.hold(0);
                connection.down.hold(now + 1);
                continue;
            }
            let (link, abandoned) = (connection.link, connection.abandoned);
            let (up, down) = (connection.up.len(), connection.down.len());
            let later = self.transit(link, Direction::Down, down, now);
            let arrival = self.transit(link, Direction::Up, up, now);
            let Some(connection) = &mut self.connections[index] else {
                continue;
            };
            connection.down.release(later);
            if connection.up.release(arrival) {
                self.schedule(arrival, Some(link), Event::Arrival(index as u32));
            }
            if abandoned {
                self.schedule(arrival, Some(link), Event::End(index as u32));
            }
        }
    }

    pub(super) fn open(&mut self, link: usize, now: u64) -> usize {
        self.opened = self.opened.wrapping_add(1);
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
        let mut index = self.connections.len();
        if self.vacant > 0 {
            let vacant = self.connections.iter().position(Option::is_none);
            index = vacant.unwrap_or(index);
        }
        if index == self.connections.len() {
            self.connections.push(None);
        } else {
            self.vacant -= 1;
        }
        self.connections[index] = Some(connection);
        index
    }

    /// The robot's bytes reach the broker.
    pub(super) fn arrive(&mut self, index: usize, now: u64) {
        let Some(Some(connection)) = self.connections.get_mut(index) else {
            return;
        };
        if connection.closed || self.links[connection.link].state() != Cut::None {
            return;
        }
        let link = connection.link;
        let mut bytes = std::mem::take(&mut self.scratch);
        bytes.append(&mut connection.pending);
        let before = bytes.len();
        connection.up.read_to(now, &mut bytes);
        if bytes.len() == before {
            connection.pending = bytes;
            return;
        }
        connection.heard = now;
        let mut client = connection.client.take();
        let greeted = client.is_some();
        let mut out = Output::default();
        let mut used = 0;
        let fault = loop {
            match packet::frame_len(&bytes[used..]) {
                Ok(Some(len)) if len <= bytes.len() - used => {
                    let frame = &bytes[used..used + len];
                    let from = Place {
                        connection: index,
                        link,
                    };
                    let result = self.peer.receive(from, &mut client, frame, now, &mut out);
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
            // Packets seldom arrive in parts, so that this is nothing and takes no memory.
            connection.pending = bytes[used..].to_vec();
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
            let link = connection.link;
            if patience > 0 {
                self.schedule(
                    now + patience,
                    Some(link),
                    Event::Patience(index as u32, serial),
                );
            }
        }
    }

    pub(super) fn check_patience(&mut self, index: usize, serial: u32, now: u64) {
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
            let link = connection.link;
            self.schedule(due, Some(link), Event::Patience(index as u32, serial));
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
        // A client that reads too slowly is closed, and told so: every round but the last closes
        // a connection.
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
                let arrival = self.arrival(link, Direction::Down, bytes.len(), now);
                if let Some(Some(connection)) = self.connections.get_mut(index) {
                    connection.down.write(&bytes, arrival);
                }
            }
            if out.close.is_empty() && out.bytes.is_empty() {
                return;
            }
            for index in std::mem::take(&mut out.close) {
                self.close(index, now);
            }
        }
    }

    fn vacate(&mut self, index: usize) {
        self.connections[index] = None;
        self.vacant += 1;
    }

    pub(super) fn close(&mut self, index: usize, now: u64) {
        let Some(Some(connection)) = self.connections.get_mut(index) else {
            return;
        };
        if connection.closed {
            return;
        }
        connection.closed = true;
        connection.up.end();
        connection.down.end();
        let link = connection.link;
        let client = connection.client.take();
        if connection.abandoned {
            self.vacate(index);
        }
        if let Some(client) = client
            && let Some(expires) = self.peer.lost(index, client, now)
        {
            self.schedule(expires.max(now + 1), Some(link), Event::Expiry);
        }
    }

    /// The end of the robot's stream reaches the broker.
    pub(super) fn end(&mut self, index: usize, now: u64) {
        let gone = matches!(self.connections.get(index), Some(Some(connection))
            if connection.abandoned && self.links[connection.link].state() == Cut::None);
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
            self.vacate(index);
            return;
        }
        let link = connection.link;
        let last = connection.up.next_arrival().map(|_| connection.up.last());
        if self.links[link].state() == Cut::None {
            // The end of the stream does not overtake its bytes.
            let arrival = (now + self.delay(link, now)).max(last.unwrap_or(0));
            self.schedule(arrival, Some(link), Event::End(index as u32));
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
        self.schedule(next, None, Event::Time);
    }
}
