//! A network in virtual time: an ordered byte stream from each robot to a broker in the process.
//!
//! The real link code of the robots runs over it. What a radio does to a TCP connection is
//! modelled where it is felt: each write arrives after a latency with jitter, a lost segment
//! holds up everything behind it until it is sent again, and a partition holds up everything
//! until it heals. All of it is drawn from the seed.

mod packet;
mod peer;
mod pipe;
mod stream;
#[cfg(test)]
mod tests;

use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use crawler_hal::{Clock, Duration, Instant};
use embassy_futures::select::select;
use rand_core::Rng;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

pub use packet::PacketError;
pub use peer::{Origin, PeerFault, PeerStatistics, Published};
pub use stream::{ConnectionReset, LockstepMonitor, LockstepNetwork, LockstepStream};

use crate::sched::SimClock;
use packet::Publication;
use peer::{Client, Output, Peer};
use pipe::{HELD, Pipe};

/// Bytes a robot may have under way before a write waits: a small TCP send buffer.
const SEND_BUFFER: usize = 8 * 1024;
/// Bytes the broker may have under way to a robot before it gives the connection up.
const MAX_BACKLOG: usize = 256 * 1024;

/// How a link behaves. All robots of a simulation share one model; their draws differ.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinkModel {
    /// Shortest time one way, milliseconds.
    pub latency_ms: f32,
    /// Added to it, uniformly from 0 to this, milliseconds.
    pub jitter_ms: f32,
    /// Probability that a segment is lost and has to be sent again.
    pub loss: f32,
    /// Time until a lost segment is sent again, doubled each time it is lost again, milliseconds.
    pub retransmit_ms: f32,
    /// Signal strength that robots report, dBm.
    pub rssi_dbm: i8,
}

impl Default for LinkModel {
    /// A quiet wireless LAN.
    fn default() -> Self {
        Self {
            latency_ms: 2.0,
            jitter_ms: 3.0,
            loss: 0.0,
            retransmit_ms: 200.0,
            rssi_dbm: -55,
        }
    }
}

impl LinkModel {
    /// Checks that every number is one a link can have.
    ///
    /// # Errors
    /// The name of the field that is out of range, and its range.
    pub fn validate(&self) -> Result<(), &'static str> {
        let within = |value: f32, low: f32, high: f32| (low..=high).contains(&value);
        if !within(self.latency_ms, 0.1, 10_000.0) {
            Err("latency_ms must be 0.1 to 10000")
        } else if !within(self.jitter_ms, 0.0, 10_000.0) {
            Err("jitter_ms must be 0 to 10000")
        } else if !within(self.loss, 0.0, 0.9) {
            Err("loss must be 0 to 0.9")
        } else if !within(self.retransmit_ms, 1.0, 10_000.0) {
            Err("retransmit_ms must be 1 to 10000")
        } else {
            Ok(())
        }
    }
}

/// What is wrong with a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Cut {
    /// Nothing.
    #[default]
    None,
    /// Nothing gets through, and nobody is told.
    Silent,
    /// The radio has lost its access point, and the robot can know it.
    Radio,
}

/// One robot's way to the broker.
#[derive(Debug)]
struct Link {
    cut: Cut,
    rng: Pcg32,
    /// Woken when the link heals.
    waiting: Option<Waker>,
}

/// What became of the robot's end of a connection.
#[derive(Debug)]
struct Connection {
    /// Tells it from an earlier one in the same place.
    serial: u64,
    link: usize,
    up: Pipe,
    down: Pipe,
    /// What arrived from the robot and is no whole packet yet.
    pending: Vec<u8>,
    client: Option<Client>,
    /// When the broker heard something last.
    heard: u64,
    /// The robot dropped its end.
    abandoned: bool,
    /// The broker is done with it.
    closed: bool,
}

/// Something the network does by itself, in order of time and then of cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
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

struct State {
    model: LinkModel,
    links: Vec<Link>,
    connections: Vec<Option<Connection>>,
    peer: Peer,
    events: BinaryHeap<Reverse<(u64, u64, Event)>>,
    arrivals: u64,
    /// Connections ever opened.
    opened: u64,
    /// When the network task is going to wake.
    armed: u64,
    /// Wakes the network task when something is to happen earlier.
    kick: Option<Waker>,
    time: Option<TimeService>,
    /// For reading packets out of a connection while it is borrowed.
    scratch: Vec<u8>,
}

struct TimeService {
    topic: String,
    every_us: u64,
    epoch_ms: u64,
}

/// The network of one simulation. A handle; clones are the same network.
#[derive(Clone)]
pub struct Air {
    state: Rc<RefCell<State>>,
    clock: SimClock,
    seed: u64,
}

impl Air {
    /// A network without robots, in the time of `clock`.
    #[must_use]
    pub fn new(model: LinkModel, seed: u64, clock: &SimClock) -> Self {
        Self {
            state: Rc::new(RefCell::new(State {
                model,
                links: Vec::new(),
                connections: Vec::new(),
                peer: Peer::new(),
                events: BinaryHeap::new(),
                arrivals: 0,
                opened: 0,
                armed: 0,
                kick: None,
                time: None,
                scratch: Vec::new(),
            })),
            clock: clock.world(),
            seed,
        }
    }

    /// The network interface of one more robot. Its clone for the robot's next boot comes from
    /// [`Air::rejoin`].
    #[must_use]
    pub fn add_link(&self) -> LockstepNetwork {
        let mut state = self.state.borrow_mut();
        let link = state.links.len();
        state.links.push(Link {
            cut: Cut::None,
            rng: Pcg32::new(self.seed ^ 0x6C69_6E6B, link as u64),
            waiting: None,
        });
        LockstepNetwork::new(self.clone(), link)
    }

    /// The network interface of link number `link` for a program that starts anew.
    #[must_use]
    pub fn rejoin(&self, link: usize) -> LockstepNetwork {
        LockstepNetwork::new(self.clone(), link)
    }

    /// Keeps up to `limit` published messages for [`Air::take_record`]; later ones are counted.
    pub fn record(&self, limit: usize) {
        self.state.borrow_mut().peer.record(limit);
    }

    /// Takes the messages recorded so far.
    #[must_use]
    pub fn take_record(&self) -> Vec<Published> {
        self.state.borrow_mut().peer.take_record()
    }

    /// Takes the faults for which the broker closed connections, with the clients' names.
    #[must_use]
    pub fn take_faults(&self) -> Vec<(Rc<str>, PeerFault)> {
        self.state.borrow_mut().peer.take_faults()
    }

    /// Totals of the broker.
    #[must_use]
    pub fn statistics(&self) -> PeerStatistics {
        self.state.borrow().peer.statistics()
    }

    /// Number of clients with a session and a connection.
    #[must_use]
    pub fn connected(&self) -> usize {
        self.state.borrow().peer.connected()
    }

    /// Whether `client` is connected and subscribed to exactly `topic`.
    #[must_use]
    pub fn listens(&self, client: &str, topic: &str) -> bool {
        self.state.borrow().peer.listens(client, topic)
    }

    /// A fingerprint of every message published so far: when, by whom, where and what.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        self.state.borrow().peer.fingerprint()
    }

    /// Publishes a message from the server's side of the broker.
    pub fn publish(&self, topic: &str, payload: &[u8], at_least_once: bool, retain: bool) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        let message = Publication {
            topic,
            payload,
            at_least_once,
            retain,
        };
        let mut out = Output::default();
        state.peer.route(&message, &mut out);
        state.carry_out(out, now);
    }

    /// Tells the time on `topic` from now on: `epoch_ms` is Unix time at the beginning of the
    /// world.
    pub fn serve_time(&self, topic: &str, epoch_ms: u64, every: Duration) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        let first = state.time.is_none();
        state.time = Some(TimeService {
            topic: topic.to_owned(),
            every_us: every.as_micros().max(1_000),
            epoch_ms,
        });
        if first {
            state.schedule(now, Event::Time);
        }
    }

    /// Cuts or heals a link. Unknown links are ignored.
    pub fn cut(&self, link: usize, cut: Cut) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        let Some(known) = state.links.get_mut(link) else {
            return;
        };
        let before = std::mem::replace(&mut known.cut, cut);
        if before == Cut::None && cut != Cut::None {
            for connection in state.connections.iter_mut().flatten() {
                if connection.link == link {
                    // The broker reads at once, so whatever is left has not arrived.
                    connection.up.hold(0);
                    connection.down.hold(now + 1);
                }
            }
        } else if before != Cut::None && cut == Cut::None {
            if let Some(waker) = known.waiting.take() {
                waker.wake();
            }
            let arrival = now + state.delay(link);
            for index in 0..state.connections.len() {
                let Some(connection) = &mut state.connections[index] else {
                    continue;
                };
                if connection.link != link {
                    continue;
                }
                connection.down.release(arrival);
                let arrives = connection.up.release(arrival);
                let abandoned = connection.abandoned;
                if arrives {
                    state.schedule(arrival, Event::Arrival(index));
                }
                if abandoned {
                    state.schedule(arrival, Event::End(index));
                }
            }
        }
    }

    /// The network at work: carries what is due and runs the broker. Never returns; the
    /// simulation runs it as a task.
    pub(crate) async fn run(self) {
        loop {
            let next = self.process();
            let kicked = poll_fn(|cx| {
                let mut state = self.state.borrow_mut();
                if state.armed == 0 {
                    return Poll::Ready(());
                }
                match &mut state.kick {
                    Some(waker) => waker.clone_from(cx.waker()),
                    None => state.kick = Some(cx.waker().clone()),
                }
                Poll::Pending
            });
            select(kicked, self.clock.sleep_until(Instant::from_micros(next))).await;
        }
    }

    fn now(&self) -> u64 {
        self.clock.now().as_micros()
    }

    /// Does what is due; returns when the next thing is.
    fn process(&self) -> u64 {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        while let Some(&Reverse((at, _, event))) = state.events.peek() {
            if at > now {
                break;
            }
            state.events.pop();
            match event {
                Event::Arrival(index) => state.arrive(index, now),
                Event::End(index) => state.end(index, now),
                Event::Patience(index, serial) => state.check_patience(index, serial, now),
                Event::Expiry => state.peer.expire(now),
                Event::Time => state.tell_time(now),
            }
        }
        state.armed = state
            .events
            .peek()
            .map_or(u64::MAX, |&Reverse((at, _, _))| at);
        state.armed
    }
}

impl std::fmt::Debug for Air {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Air")
            .field("links", &self.state.borrow().links.len())
            .field("connected", &self.connected())
            .finish_non_exhaustive()
    }
}

impl State {
    fn schedule(&mut self, at: u64, event: Event) {
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
    fn delay(&mut self, link: usize) -> u64 {
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

    fn arrival(&mut self, link: usize, now: u64) -> u64 {
        if self.links[link].cut == Cut::None {
            now + self.delay(link)
        } else {
            HELD
        }
    }

    fn open(&mut self, link: usize, now: u64) -> usize {
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
    fn arrive(&mut self, index: usize, now: u64) {
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

    fn check_patience(&mut self, index: usize, serial: u64, now: u64) {
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
    fn carry_out(&mut self, mut out: Output, now: u64) {
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
    fn end(&mut self, index: usize, now: u64) {
        let gone = matches!(self.connections.get(index), Some(Some(connection))
            if connection.abandoned && self.links[connection.link].cut == Cut::None);
        if gone {
            let mut out = Output::default();
            out.close.push(index);
            self.carry_out(out, now);
        }
    }

    /// The robot drops its end.
    fn abandon(&mut self, index: usize, now: u64) {
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

    fn tell_time(&mut self, now: u64) {
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
