//! A network in virtual time: an ordered byte stream from each robot to a broker in the process.
//!
//! The real link code of the robots runs over it. What a radio does to a TCP connection is
//! modelled where it is felt: each write arrives after a latency with jitter, a lost segment
//! holds up everything behind it until it is sent again, and a partition holds up everything
//! until it heals. All of it is drawn from the seed.

mod exchange;
mod model;
mod outage;
mod packet;
mod peer;
mod pipe;
mod radio;
mod state;
mod stream;
#[cfg(test)]
mod tests;

use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::rc::Rc;

use crawler_hal::{Clock, Duration};
use crawler_protocol::Fleet;
use rand_pcg::Pcg32;

pub(crate) use exchange::News;
pub use model::{Cut, LinkModel};
pub use packet::PacketError;
pub use peer::{Origin, PeerFault, PeerStatistics, Published};
#[cfg(feature = "live")]
pub(crate) use pipe::{HELD, Pipe};
pub use stream::{
    ConnectionReset, LockstepMonitor, LockstepNetwork, LockstepStream, NO_ADDRESS_AFTER,
    PASSWORD_REFUSED_AFTER,
};

use crate::net::radio::{Medium, Reach, Setup};
use crate::sched::SimClock;
use crate::world::RadioFigures;
use packet::Publication;
use peer::{Output, Peer};
use state::{Event, Link, State, TimeService};

/// Bytes a robot may have under way before a write waits: a small TCP send buffer.
const SEND_BUFFER: usize = 8 * 1024;

/// The network of one simulation. A handle; clones are the same network.
#[derive(Clone)]
pub struct VirtualNetwork {
    state: Rc<RefCell<State>>,
    clock: SimClock,
    seed: u64,
}

impl VirtualNetwork {
    /// A network without robots, in the time of `clock`, that costs what `model` says wherever
    /// they are.
    #[must_use]
    pub fn new(model: LinkModel, seed: u64, clock: &SimClock) -> Self {
        let setup = Setup {
            link: model,
            radio: None,
            figures: RadioFigures::default(),
            seed,
        };
        Self::with_radio(&setup, clock)
    }

    /// A network without robots, in the time of `clock`, over a radio.
    #[must_use]
    pub fn with_radio(setup: &Setup, clock: &SimClock) -> Self {
        Self {
            state: Rc::new(RefCell::new(State {
                model: setup.link,
                radio: setup
                    .radio
                    .as_ref()
                    .map(|radio| Medium::new(setup, radio.clone())),
                links: Vec::new(),
                connections: Vec::new(),
                vacant: 0,
                peer: Peer::new(),
                events: BinaryHeap::new(),
                arrivals: 0,
                opened: 0,
                time: None,
                inbox: Vec::new(),
                airtime: Vec::new(),
                news: News::default(),
                scratch: Vec::new(),
                stopped: false,
            })),
            clock: clock.world(),
            seed: setup.seed,
        }
    }

    /// Adds the link of one more robot, and returns its number. The robot's network interface
    /// comes from [`VirtualNetwork::rejoin`], at each of its boots.
    pub fn add_link(&self) -> usize {
        let mut state = self.state.borrow_mut();
        let link = state.links.len();
        state.links.push(Link {
            cut: Cut::None,
            reach: Reach::Up,
            applied: Cut::None,
            rng: Pcg32::new(self.seed ^ 0x6C69_6E6B, link as u64),
            waiting: None,
        });
        if let Some(radio) = &mut state.radio {
            radio.add(link as u32);
        }
        link
    }

    /// The network interface of link number `link` for a program that starts.
    #[must_use]
    pub fn rejoin(&self, link: usize) -> LockstepNetwork {
        LockstepNetwork::new(self.clone(), link)
    }

    /// Keeps up to `limit` published messages for [`VirtualNetwork::take_record`]; later ones are counted.
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

    /// Whether what is sent over this link comes through: nothing has cut it, and it has not fallen silent.
    #[must_use]
    pub fn carries(&self, link: usize) -> bool {
        let state = self.state.borrow();
        let link = state.links.get(link);
        link.is_some_and(|link| link.state() == Cut::None)
    }

    /// A fingerprint of every message that came over this link so far: when, by whom, where and
    /// what.
    #[must_use]
    pub fn fingerprint(&self, link: usize) -> u64 {
        self.state.borrow().peer.fingerprint(link)
    }

    /// Publishes a message from the server's side of the broker. It is sent on at once, while
    /// what robots publish reaches other robots with the next physics step.
    pub(crate) fn publish(&self, topic: &str, payload: &[u8], at_least_once: bool, retain: bool) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        if state.stopped {
            return;
        }
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

    /// The cells that somebody listens to.
    pub(crate) fn listened_cells(&self, fleet: &Fleet) -> BTreeSet<(i16, i16)> {
        self.state.borrow().peer.listened_cells(fleet)
    }

    /// Tells the time on `topic` from now on: `epoch_ms` is Unix time at the beginning of the
    /// world.
    pub(crate) fn serve_time(&self, topic: &str, epoch_ms: u64, every: Duration) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        let first = state.time.is_none();
        state.time = Some(TimeService {
            topic: topic.to_owned(),
            every_us: every.as_micros().max(1_000),
            epoch_ms,
        });
        if first {
            state.schedule(now, None, Event::Time);
        }
    }

    /// Lets only clients in that give this name and password; `None` lets everyone in. Sessions
    /// that are open stay.
    pub(crate) fn require_credentials(&self, credentials: Option<(&str, &str)>) {
        let credentials = credentials.map(|(name, word)| (name.to_owned(), word.to_owned()));
        self.state.borrow_mut().peer.require(credentials);
    }

    /// Cuts or heals a link. Unknown links are ignored.
    pub(crate) fn cut(&self, link: usize, cut: Cut) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        let Some(known) = state.links.get_mut(link) else {
            return;
        };
        known.cut = cut;
        state.relink(now);
        state.links[link].settle();
    }

    fn now(&self) -> u64 {
        self.clock.now().as_micros()
    }

    /// When the network has something to do next, microseconds.
    pub(crate) fn next_due(&self) -> u64 {
        let state = self.state.borrow();
        state
            .events
            .peek()
            .map_or(u64::MAX, |&Reverse((at, ..))| at)
    }

    /// Does what is due. The simulation calls it when a moment begins, before any program runs:
    /// whatever programs do then arrives later.
    pub(crate) fn process(&self) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        while let Some(&Reverse((at, _, _, event))) = state.events.peek() {
            if at > now {
                break;
            }
            state.events.pop();
            match event {
                Event::Arrival(index) => state.arrive(index as usize, now),
                Event::End(index) => state.end(index as usize, now),
                Event::Patience(index, serial) => {
                    state.check_patience(index as usize, serial, now);
                }
                Event::Expiry => state.peer.expire(now),
                Event::Time => state.tell_time(now),
            }
        }
    }
}

impl std::fmt::Debug for VirtualNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VirtualNetwork")
            .field("links", &self.state.borrow().links.len())
            .field("connected", &self.connected())
            .finish_non_exhaustive()
    }
}
