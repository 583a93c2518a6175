//! A network in virtual time: an ordered byte stream from each robot to a broker in the process.
//!
//! The real link code of the robots runs over it. What a radio does to a TCP connection is
//! modelled where it is felt: each write arrives after a latency with jitter, a lost segment
//! holds up everything behind it until it is sent again, and a partition holds up everything
//! until it heals. All of it is drawn from the seed.

mod model;
mod packet;
mod peer;
mod pipe;
mod state;
mod stream;
#[cfg(test)]
mod tests;

use std::cell::RefCell;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;

use crawler_hal::{Clock, Duration, Instant};
use embassy_futures::select::select;
use rand_pcg::Pcg32;

pub use model::{Cut, LinkModel};
pub use packet::PacketError;
pub use peer::{Origin, PeerFault, PeerStatistics, Published};
pub use stream::{
    ConnectionReset, LockstepMonitor, LockstepNetwork, LockstepStream, NO_ADDRESS_AFTER,
    PASSWORD_REFUSED_AFTER,
};

use crate::sched::SimClock;
use packet::Publication;
use peer::{Output, Peer};
use state::{Event, Link, State, TimeService};

/// Bytes a robot may have under way before a write waits: a small TCP send buffer.
const SEND_BUFFER: usize = 8 * 1024;

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

    /// Lets only clients in that give this name and password; `None` lets everyone in. Sessions
    /// that are open stay.
    pub fn require_credentials(&self, credentials: Option<(&str, &str)>) {
        let credentials = credentials.map(|(name, word)| (name.to_owned(), word.to_owned()));
        self.state.borrow_mut().peer.require(credentials);
    }

    /// Cuts or heals a link. Unknown links are ignored.
    pub fn cut(&self, link: usize, cut: Cut) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        let Some(known) = state.links.get_mut(link) else {
            return;
        };
        let before = std::mem::replace(&mut known.cut, cut);
        if let Some(waker) = known.waiting.take() {
            waker.wake();
        }
        if before == Cut::None && cut != Cut::None {
            for connection in state.connections.iter_mut().flatten() {
                if connection.link == link {
                    // The broker reads at once, so whatever is left has not arrived.
                    connection.up.hold(0);
                    connection.down.hold(now + 1);
                }
            }
        } else if before != Cut::None && cut == Cut::None {
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
