//! The broker at the other end of all links: sessions, subscriptions, retained messages, wills.
//!
//! It is the peer of robots, not a broker for the world: exact in what they use, small in what
//! it keeps, and the same bytes in give the same bytes out.

mod carry;
mod report;
mod retained;
mod routing;
mod sessions;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::ops::Bound;
use std::rc::Rc;

use crawler_protocol::{Fleet, Topic};

pub(super) use carry::{Carried, FilterChange, sort as sort_carried};
pub use report::{Origin, PeerFault, PeerStatistics, Published};

use super::packet::{self, Packet};
use crate::world::Fingerprint;
use carry::Interest;
use rand_pcg::Pcg32;
use retained::{Kept, Shapes, Will};
use routing::Author;
use sessions::Session;

/// Messages one session may have waiting; more are dropped and counted.
const MAX_QUEUED: usize = 256;
/// QoS 1 messages under way to one client at a time, whatever it allows.
const MAX_IN_FLIGHT: usize = 32;
/// Filters of one session.
const MAX_FILTERS: usize = 64;
/// Retained messages of the whole broker.
const MAX_RETAINED: usize = 1 << 18;
/// Faults remembered.
const MAX_FAULTS: usize = 1_000;
/// Reason codes of MQTT 5, section 2.4.
const KEEP_ALIVE_TIMEOUT: u8 = 0x8D;
const DISCONNECT_WITH_WILL: u8 = 0x04;
const NOT_AUTHORIZED: u8 = 0x87;

/// Where a packet comes from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) connection: usize,
    pub(super) link: usize,
}

/// What a connection is to the broker.
#[derive(Debug)]
pub(super) struct Client {
    session: usize,
    link: usize,
    will: Option<Will>,
    keep_alive_us: u64,
}

/// What the broker wants done to a connection.
#[derive(Debug, Default)]
pub(super) struct Output {
    /// Bytes for each connection, in order.
    pub(super) bytes: Vec<(usize, Vec<u8>)>,
    /// Connections to close once their bytes are sent.
    pub(super) close: Vec<usize>,
}

impl Output {
    fn to(&mut self, connection: usize) -> &mut Vec<u8> {
        match self.bytes.last() {
            Some(&(last, _)) if last == connection => {}
            _ => self.bytes.push((connection, Vec::new())),
        }
        let end = self.bytes.len() - 1;
        &mut self.bytes[end].1
    }
}

/// See the [module](self).
#[derive(Debug)]
pub(super) struct Peer {
    sessions: Vec<Option<Session>>,
    by_client: BTreeMap<Rc<str>, usize>,
    /// Sessions subscribed to a filter without wildcards.
    exact: BTreeMap<Rc<str>, Vec<usize>>,
    /// Sessions with any filter that has wildcards.
    wild: Vec<usize>,
    retained: BTreeMap<Box<str>, Kept>,
    /// Of the messages that are retained, and of wills.
    shapes: Shapes,
    /// The share of QoS 1 messages that is handed on twice.
    repeats: Option<(f32, Pcg32)>,
    /// Name and password that every client must give.
    credentials: Option<(String, String)>,
    record: VecDeque<Published>,
    record_limit: usize,
    faults: Vec<(Rc<str>, PeerFault)>,
    statistics: PeerStatistics,
    /// Of what came over each link.
    prints: Vec<Fingerprint>,
    /// What robots published since the last exchange and somebody may want.
    outbox: Vec<Carried>,
    /// Numbers the time between two exchanges.
    window: u64,
    /// What is subscribed to in other shards of the world; `None` where there are none.
    abroad: Option<Interest>,
}

impl Peer {
    pub(super) fn new() -> Self {
        Self {
            sessions: Vec::new(),
            by_client: BTreeMap::new(),
            exact: BTreeMap::new(),
            wild: Vec::new(),
            retained: BTreeMap::new(),
            shapes: Shapes::default(),
            repeats: None,
            credentials: None,
            record: VecDeque::new(),
            record_limit: 0,
            faults: Vec::new(),
            statistics: PeerStatistics::default(),
            prints: Vec::new(),
            outbox: Vec::new(),
            window: 1,
            abroad: None,
        }
    }

    pub(super) fn require(&mut self, credentials: Option<(String, String)>) {
        self.credentials = credentials;
    }

    /// Keeps nothing but its counters and what it was told to be.
    pub(super) fn forget(&mut self) {
        self.sessions = Vec::new();
        self.by_client = BTreeMap::new();
        self.exact = BTreeMap::new();
        self.wild = Vec::new();
        self.retained = BTreeMap::new();
        self.shapes = Shapes::default();
        self.outbox = Vec::new();
    }

    /// Hands on this share of QoS 1 messages twice.
    pub(super) fn repeat(&mut self, share: f32, rng: Pcg32) {
        self.repeats = Some((share, rng));
    }

    fn admits(&self, connect: &packet::Connect<'_>) -> bool {
        self.credentials.as_ref().is_none_or(|(name, word)| {
            connect.username == Some(name) && connect.password == Some(word.as_bytes())
        })
    }

    pub(super) fn record(&mut self, limit: usize) {
        self.record_limit = limit;
        self.record.truncate(limit);
    }

    pub(super) fn take_record(&mut self) -> Vec<Published> {
        self.record.drain(..).collect()
    }

    pub(super) fn take_faults(&mut self) -> Vec<(Rc<str>, PeerFault)> {
        std::mem::take(&mut self.faults)
    }

    pub(super) fn statistics(&self) -> PeerStatistics {
        self.statistics
    }

    pub(super) fn fingerprint(&self, link: usize) -> u64 {
        let print = self.prints.get(link).copied();
        print.unwrap_or_default().value()
    }

    /// Whether the client is connected and subscribed to `topic` by its exact name.
    pub(super) fn listens(&self, client: &str, topic: &str) -> bool {
        self.by_client.get(client).is_some_and(|&index| {
            self.sessions[index].as_ref().is_some_and(|session| {
                session.connection.is_some() && session.filters.iter().any(|f| *f.text == *topic)
            })
        })
    }

    /// The cells that somebody is subscribed to.
    pub(super) fn listened_cells(&self, fleet: &Fleet) -> BTreeSet<(i16, i16)> {
        let prefix = format!("{}/cell/", fleet.as_str());
        let from = (Bound::Included(prefix.as_str()), Bound::Unbounded);
        self.exact
            .range::<str, _>(from)
            .take_while(|(topic, _)| topic.starts_with(&prefix))
            .filter(|(_, sessions)| !sessions.is_empty())
            .filter_map(|(topic, _)| match Topic::parse(fleet, topic) {
                Ok(Topic::Cell { x, y }) => Some((x, y)),
                _ => None,
            })
            .collect()
    }

    pub(super) fn connected(&self) -> usize {
        let all = self.sessions.iter().flatten();
        all.filter(|session| session.connection.is_some()).count()
    }

    /// Keep-alive of a connection in microseconds with the grace of section 3.1.2.10; 0 without.
    pub(super) fn patience(client: &Client) -> u64 {
        client.keep_alive_us + client.keep_alive_us / 2
    }

    /// Takes in one whole packet.
    ///
    /// # Errors
    /// Why the connection must be closed; [`Peer::lost`] is still to be called.
    pub(super) fn receive(
        &mut self,
        place: Place,
        client: &mut Option<Client>,
        frame: &[u8],
        now: u64,
        out: &mut Output,
    ) -> Result<(), PeerFault> {
        let connection = place.connection;
        let packet = packet::parse(frame).map_err(PeerFault::Packet)?;
        let Some(known) = client else {
            let Packet::Connect(connect) = packet else {
                return Err(PeerFault::Order);
            };
            if !self.admits(&connect) {
                packet::write_conn_ack(out.to(connection), false, NOT_AUTHORIZED);
                return Err(PeerFault::NotAuthorized);
            }
            *client = Some(self.connect(place, &connect, now, out));
            return Ok(());
        };
        match packet {
            Packet::Connect(_) => return Err(PeerFault::Order),
            Packet::Publish {
                message,
                id,
                duplicate,
            } => {
                let from = Author {
                    client: self.client_of(known.session),
                    link: known.link,
                };
                let repeated = message.at_least_once
                    && self.is_repeated(known.session, id, duplicate, &message);
                let origin = if repeated {
                    Origin::Repeated
                } else {
                    Origin::Client
                };
                self.published(&from, &message, origin, now);
                if message.at_least_once {
                    packet::write_pub_ack(out.to(connection), id);
                }
            }
            Packet::PubAck { id } => {
                if let Some(session) = &mut self.sessions[known.session] {
                    session.in_flight.retain(|(flying, ..)| *flying != id);
                }
                self.pump(known.session, out);
            }
            Packet::Subscribe { id, filters } => {
                self.subscribe(known, connection, id, &filters, out)?;
            }
            Packet::Unsubscribe { id, filters } => {
                let mut codes = Vec::new();
                for filter in filters {
                    codes.push(if self.unsubscribe(known.session, filter) {
                        0
                    } else {
                        0x11
                    });
                }
                packet::write_sub_ack(out.to(connection), 0xB0, id, &codes);
            }
            Packet::PingReq => packet::write_ping_resp(out.to(connection)),
            Packet::Disconnect {
                reason,
                session_expiry_s,
            } => {
                if reason != DISCONNECT_WITH_WILL
                    && let Some(will) = known.will.take()
                {
                    self.shapes.release(will.kept);
                }
                if let (Some(expiry), Some(session)) =
                    (session_expiry_s, &mut self.sessions[known.session])
                {
                    session.expiry_s = expiry;
                }
                out.close.push(connection);
            }
        }
        Ok(())
    }

    /// Notes a fault; the bytes tell the client why, where the standard has a word for it.
    pub(super) fn closed_for(
        &mut self,
        connection: usize,
        client: Option<&Client>,
        fault: PeerFault,
        out: &mut Output,
    ) {
        let name = client.map_or_else(|| Rc::from(""), |client| self.client_of(client.session));
        if fault == PeerFault::KeepAlive {
            packet::write_disconnect(out.to(connection), KEEP_ALIVE_TIMEOUT);
        }
        self.fault(name, fault);
    }

    fn fault(&mut self, client: Rc<str>, fault: PeerFault) {
        self.statistics.faults += 1;
        if self.faults.len() < MAX_FAULTS {
            self.faults.push((client, fault));
        }
    }
}
