//! The broker at the other end of all links: sessions, subscriptions, retained messages, wills.
//!
//! It is the peer of robots, not a broker for the world: exact in what they use, small in what
//! it keeps, and the same bytes in give the same bytes out.

use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;

use crawler_hal::Instant;

use super::packet::{self, Connect, Packet, PacketError, Publication};
use crate::run::Fingerprint;

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
const SESSION_TAKEN_OVER: u8 = 0x8E;
const QUOTA_EXCEEDED: u8 = 0x97;
const DISCONNECT_WITH_WILL: u8 = 0x04;

/// A message that a robot published, as its broker got it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Published {
    /// When it arrived.
    pub at: Instant,
    /// Who sent it.
    pub client: Rc<str>,
    /// Topic, fleet included.
    pub topic: String,
    /// The message.
    pub payload: Vec<u8>,
    /// QoS 1.
    pub at_least_once: bool,
    /// To be kept for later subscribers.
    pub retain: bool,
    /// Where it comes from.
    pub origin: Origin,
}

/// Where a published message comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The client sent it.
    Client,
    /// The client sent it again, and the first copy had arrived.
    Repeated,
    /// It is the last will of a client that was lost.
    Will,
}

/// Why a connection was closed by the broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PeerFault {
    /// The client sent what is no MQTT 5.
    Packet(PacketError),
    /// The first packet was not CONNECT, or a later one was.
    Order,
    /// Silence for one and a half times the keep-alive.
    KeepAlive,
    /// The same client connected again.
    TakenOver,
    /// The client reads too slowly.
    TooSlow,
    /// Too many filters.
    Quota,
}

impl std::fmt::Display for PeerFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Packet(error) => write!(f, "{error}"),
            Self::Order => f.write_str("CONNECT must come first and once"),
            Self::KeepAlive => f.write_str("silent for one and a half times the keep-alive"),
            Self::TakenOver => f.write_str("taken over by a new connection"),
            Self::TooSlow => f.write_str("the client reads too slowly"),
            Self::Quota => write!(f, "more than {MAX_FILTERS} filters"),
        }
    }
}

impl std::error::Error for PeerFault {}

/// Totals of a broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct PeerStatistics {
    /// Messages received from clients.
    pub received: u64,
    /// Messages sent to clients, repetitions included.
    pub sent: u64,
    /// Messages dropped because a queue was full or the client would not take their size.
    pub dropped: u64,
    /// Published messages that were not recorded for lack of room.
    pub unrecorded: u64,
    /// Connections that the broker closed for a fault.
    pub faults: u64,
}

#[derive(Debug)]
struct Message {
    topic: String,
    payload: Vec<u8>,
    at_least_once: bool,
    retain: bool,
}

impl Message {
    fn of(publication: &Publication<'_>) -> Self {
        Self {
            topic: publication.topic.to_owned(),
            payload: publication.payload.to_owned(),
            at_least_once: publication.at_least_once,
            retain: publication.retain,
        }
    }

    fn publication(&self, at_least_once: bool, retain: bool) -> Publication<'_> {
        Publication {
            topic: &self.topic,
            payload: &self.payload,
            at_least_once: at_least_once && self.at_least_once,
            retain,
        }
    }
}

#[derive(Debug)]
struct Session {
    client: Rc<str>,
    /// Connection in use.
    connection: Option<usize>,
    /// Each filter with the QoS it grants.
    filters: Vec<(String, bool)>,
    in_flight: VecDeque<(u16, Rc<Message>, bool)>,
    queue: VecDeque<(Rc<Message>, bool)>,
    next_id: u16,
    /// QoS 1 messages its client takes at a time.
    window: usize,
    /// Longest packet its client takes.
    largest: usize,
    expiry_s: u32,
    /// When the session ends, while its client is away.
    expires: u64,
    /// What arrived last under each packet identifier, to tell repetitions: bounded by the
    /// receive maximum of 65,535 that is the standard's default, in practice by the client's few.
    seen: BTreeMap<u16, u64>,
}

/// What a connection is to the broker.
#[derive(Debug)]
pub(super) struct Client {
    session: usize,
    will: Option<Rc<Message>>,
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
    exact: BTreeMap<String, Vec<usize>>,
    /// Sessions with any filter that has wildcards.
    wild: Vec<usize>,
    retained: BTreeMap<String, Rc<Message>>,
    record: VecDeque<Published>,
    record_limit: usize,
    faults: Vec<(Rc<str>, PeerFault)>,
    statistics: PeerStatistics,
    fingerprint: Fingerprint,
}

impl Peer {
    pub(super) fn new() -> Self {
        Self {
            sessions: Vec::new(),
            by_client: BTreeMap::new(),
            exact: BTreeMap::new(),
            wild: Vec::new(),
            retained: BTreeMap::new(),
            record: VecDeque::new(),
            record_limit: 0,
            faults: Vec::new(),
            statistics: PeerStatistics::default(),
            fingerprint: Fingerprint::new(),
        }
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

    pub(super) fn fingerprint(&self) -> u64 {
        self.fingerprint.value()
    }

    /// Whether the client is connected and subscribed to `topic` by its exact name.
    pub(super) fn listens(&self, client: &str, topic: &str) -> bool {
        self.by_client.get(client).is_some_and(|&index| {
            self.sessions[index].as_ref().is_some_and(|session| {
                session.connection.is_some() && session.filters.iter().any(|(f, _)| f == topic)
            })
        })
    }

    pub(super) fn connected(&self) -> usize {
        let all = self.sessions.iter().flatten();
        all.filter(|session| session.connection.is_some()).count()
    }

    /// Keep-alive of a connection in microseconds with the grace of section 3.1.2.10; 0 without.
    pub(super) fn patience(client: &Client) -> u64 {
        client.keep_alive_us + client.keep_alive_us / 2
    }

    /// Takes in one whole packet from `connection`.
    ///
    /// # Errors
    /// Why the connection must be closed; [`Peer::lost`] is still to be called.
    pub(super) fn receive(
        &mut self,
        connection: usize,
        client: &mut Option<Client>,
        frame: &[u8],
        now: u64,
        out: &mut Output,
    ) -> Result<(), PeerFault> {
        let packet = packet::parse(frame).map_err(PeerFault::Packet)?;
        let Some(known) = client else {
            let Packet::Connect(connect) = packet else {
                return Err(PeerFault::Order);
            };
            *client = Some(self.connect(connection, &connect, now, out));
            return Ok(());
        };
        match packet {
            Packet::Connect(_) => return Err(PeerFault::Order),
            Packet::Publish {
                message,
                id,
                duplicate,
            } => {
                let from = self.client_of(known.session);
                let repeated = message.at_least_once
                    && self.is_repeated(known.session, id, duplicate, &message);
                let origin = if repeated {
                    Origin::Repeated
                } else {
                    Origin::Client
                };
                self.published(&from, &message, origin, now, out);
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
                if reason != DISCONNECT_WITH_WILL {
                    known.will = None;
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

    fn client_of(&self, session: usize) -> Rc<str> {
        self.sessions[session]
            .as_ref()
            .map_or_else(|| Rc::from(""), |session| Rc::clone(&session.client))
    }

    fn is_repeated(
        &mut self,
        session: usize,
        id: u16,
        duplicate: bool,
        message: &Publication<'_>,
    ) -> bool {
        let mut print = Fingerprint::new();
        print.bytes(message.topic.as_bytes());
        print.bytes(message.payload);
        let Some(session) = &mut self.sessions[session] else {
            return false;
        };
        session.seen.insert(id, print.value()) == Some(print.value()) && duplicate
    }

    fn connect(
        &mut self,
        connection: usize,
        connect: &Connect<'_>,
        now: u64,
        out: &mut Output,
    ) -> Client {
        let existing = self.by_client.get(connect.client).copied();
        if let Some(index) = existing
            && let Some(session) = &mut self.sessions[index]
            && let Some(old) = session.connection.take()
        {
            packet::write_disconnect(out.to(old), SESSION_TAKEN_OVER);
            out.close.push(old);
            let client = Rc::clone(&session.client);
            self.fault(client, PeerFault::TakenOver);
        }
        let kept = existing.filter(|&index| {
            let session = self.sessions[index].as_ref();
            !connect.clean_start && session.is_some_and(|session| session.expires > now)
        });
        if kept.is_none()
            && let Some(index) = existing
        {
            self.end_session(index);
        }
        let index = kept.unwrap_or_else(|| self.new_session(connect.client));
        if let Some(session) = &mut self.sessions[index] {
            session.connection = Some(connection);
            session.window = usize::from(connect.receive_maximum).min(MAX_IN_FLIGHT);
            session.largest = connect.maximum_packet as usize;
            session.expiry_s = connect.session_expiry_s;
            session.expires = u64::MAX;
        }
        packet::write_conn_ack(out.to(connection), kept.is_some(), 0);
        let client = Client {
            session: index,
            will: connect.will.as_ref().map(|will| Rc::new(Message::of(will))),
            keep_alive_us: u64::from(connect.keep_alive_s) * 1_000_000,
        };
        // What the client has not acknowledged goes again, under its old number.
        if let Some(session) = &self.sessions[index] {
            for (id, message, retained) in &session.in_flight {
                self.statistics.sent += 1;
                let publication = message.publication(true, *retained);
                packet::write_publish(out.to(connection), &publication, *id, true);
            }
        }
        self.pump(index, out);
        client
    }

    fn new_session(&mut self, client: &str) -> usize {
        let client: Rc<str> = Rc::from(client);
        let index = self
            .sessions
            .iter()
            .position(Option::is_none)
            .unwrap_or(self.sessions.len());
        if index == self.sessions.len() {
            self.sessions.push(None);
        }
        self.sessions[index] = Some(Session {
            client: Rc::clone(&client),
            connection: None,
            filters: Vec::new(),
            in_flight: VecDeque::new(),
            queue: VecDeque::new(),
            next_id: 1,
            window: MAX_IN_FLIGHT,
            largest: usize::MAX,
            expiry_s: 0,
            expires: u64::MAX,
            seen: BTreeMap::new(),
        });
        self.by_client.insert(client, index);
        index
    }

    fn end_session(&mut self, index: usize) {
        let Some(session) = self.sessions[index].take() else {
            return;
        };
        self.by_client.remove(&session.client);
        for (filter, _) in session.filters {
            self.forget_filter(index, &filter);
        }
    }

    fn forget_filter(&mut self, session: usize, filter: &str) {
        if filter.contains(['+', '#']) {
            let still = self.sessions[session]
                .as_ref()
                .is_some_and(|s| s.filters.iter().any(|(f, _)| f.contains(['+', '#'])));
            if !still {
                self.wild.retain(|&s| s != session);
            }
        } else if let Some(subscribers) = self.exact.get_mut(filter) {
            subscribers.retain(|&s| s != session);
            if subscribers.is_empty() {
                self.exact.remove(filter);
            }
        }
    }

    fn subscribe(
        &mut self,
        client: &Client,
        connection: usize,
        id: u16,
        filters: &[(&str, u8)],
        out: &mut Output,
    ) -> Result<(), PeerFault> {
        let mut codes = Vec::new();
        let mut welcome = Vec::new();
        for &(filter, options) in filters {
            let Some(session) = &mut self.sessions[client.session] else {
                return Err(PeerFault::Order);
            };
            let at_least_once = options & 3 > 0;
            let known = session.filters.iter().position(|(f, _)| f == filter);
            let is_new = known.is_none();
            match known {
                Some(place) => session.filters[place].1 = at_least_once,
                None if session.filters.len() == MAX_FILTERS => {
                    packet::write_disconnect(out.to(connection), QUOTA_EXCEEDED);
                    return Err(PeerFault::Quota);
                }
                None => session.filters.push((filter.to_owned(), at_least_once)),
            }
            if is_new {
                self.note_filter(client.session, filter);
            }
            codes.push(u8::from(at_least_once));
            // Retain handling: 0 always, 1 when the subscription is new, 2 never.
            let handling = options >> 4 & 3;
            if handling == 0 || (handling == 1 && is_new) {
                welcome.extend(
                    self.retained
                        .iter()
                        .filter(|(topic, _)| packet::matches(filter, topic))
                        .map(|(_, message)| Rc::clone(message)),
                );
            }
        }
        packet::write_sub_ack(out.to(connection), 0x90, id, &codes);
        for message in welcome {
            self.deliver(client.session, &message, true, out);
        }
        Ok(())
    }

    fn note_filter(&mut self, session: usize, filter: &str) {
        let list = if filter.contains(['+', '#']) {
            &mut self.wild
        } else {
            self.exact.entry(filter.to_owned()).or_default()
        };
        if let Err(place) = list.binary_search(&session) {
            list.insert(place, session);
        }
    }

    fn unsubscribe(&mut self, session: usize, filter: &str) -> bool {
        let Some(known) = &mut self.sessions[session] else {
            return false;
        };
        let before = known.filters.len();
        known.filters.retain(|(f, _)| f != filter);
        let removed = known.filters.len() < before;
        if removed {
            self.forget_filter(session, filter);
        }
        removed
    }

    /// A message from a client.
    fn published(
        &mut self,
        from: &Rc<str>,
        message: &Publication<'_>,
        origin: Origin,
        now: u64,
        out: &mut Output,
    ) {
        self.statistics.received += 1;
        self.fingerprint.word(now);
        self.fingerprint.bytes(from.as_bytes());
        self.fingerprint.bytes(message.topic.as_bytes());
        self.fingerprint.bytes(message.payload);
        if self.record.len() < self.record_limit {
            self.record.push_back(Published {
                at: Instant::from_micros(now),
                client: Rc::clone(from),
                topic: message.topic.to_owned(),
                payload: message.payload.to_owned(),
                at_least_once: message.at_least_once,
                retain: message.retain,
                origin,
            });
        } else {
            self.statistics.unrecorded += 1;
        }
        self.route(message, out);
    }

    /// Sends a message to whoever subscribed to it, and keeps it when it is retained.
    pub(super) fn route(&mut self, message: &Publication<'_>, out: &mut Output) {
        let mut shared = None;
        if message.retain {
            if message.payload.is_empty() {
                self.retained.remove(message.topic);
            } else {
                let made = Rc::new(Message::of(message));
                if let Some(known) = self.retained.get_mut(message.topic) {
                    known.clone_from(&made);
                } else if self.retained.len() < MAX_RETAINED {
                    self.retained
                        .insert(message.topic.to_owned(), Rc::clone(&made));
                } else {
                    self.statistics.dropped += 1;
                }
                shared = Some(made);
            }
        }
        let mut listeners = self.exact.get(message.topic).cloned().unwrap_or_default();
        for &index in &self.wild {
            let selected = self.sessions[index].as_ref().is_some_and(|s| {
                s.filters
                    .iter()
                    .any(|(f, _)| packet::matches(f, message.topic))
            });
            if selected && !listeners.contains(&index) {
                listeners.push(index);
            }
        }
        if listeners.is_empty() {
            return;
        }
        let shared = shared.unwrap_or_else(|| Rc::new(Message::of(message)));
        for index in listeners {
            self.deliver(index, &shared, false, out);
        }
    }

    /// Sends one message to one session, or queues it.
    fn deliver(&mut self, index: usize, message: &Rc<Message>, retained: bool, out: &mut Output) {
        let Some(session) = &mut self.sessions[index] else {
            return;
        };
        let granted = session
            .filters
            .iter()
            .any(|(f, at_least_once)| *at_least_once && packet::matches(f, &message.topic));
        let publication = message.publication(granted, retained);
        if !publication.at_least_once {
            // QoS 0: now or never.
            if let Some(connection) = session.connection {
                if packet::publish_len(&publication) > session.largest {
                    self.statistics.dropped += 1;
                } else {
                    self.statistics.sent += 1;
                    packet::write_publish(out.to(connection), &publication, 0, false);
                }
            }
            return;
        }
        if session.queue.len() >= MAX_QUEUED {
            self.statistics.dropped += 1;
            return;
        }
        session.queue.push_back((Rc::clone(message), retained));
        self.pump(index, out);
    }

    /// Sends queued messages while the client allows more to be under way.
    fn pump(&mut self, index: usize, out: &mut Output) {
        let Some(session) = &mut self.sessions[index] else {
            return;
        };
        let Some(connection) = session.connection else {
            return;
        };
        while session.in_flight.len() < session.window
            && let Some((message, retained)) = session.queue.pop_front()
        {
            let publication = message.publication(true, retained);
            if packet::publish_len(&publication) > session.largest {
                self.statistics.dropped += 1;
                continue;
            }
            let id = loop {
                let id = session.next_id;
                session.next_id = session.next_id.checked_add(1).unwrap_or(1);
                if !session.in_flight.iter().any(|(flying, ..)| *flying == id) {
                    break id;
                }
            };
            self.statistics.sent += 1;
            packet::write_publish(out.to(connection), &publication, id, false);
            session.in_flight.push_back((id, message, retained));
        }
    }

    /// A connection is gone: publishes the will, and keeps the session for its time. Returns
    /// when the session is to be ended unless its client comes back, if it has one.
    pub(super) fn lost(
        &mut self,
        connection: usize,
        client: Client,
        now: u64,
        out: &mut Output,
    ) -> Option<u64> {
        let from = self.client_of(client.session);
        if let Some(will) = client.will {
            self.published(
                &from,
                &will.publication(true, will.retain),
                Origin::Will,
                now,
                out,
            );
        }
        let session = self.sessions[client.session].as_mut()?;
        if session.connection != Some(connection) {
            return None;
        }
        session.connection = None;
        session.expires = match session.expiry_s {
            u32::MAX => u64::MAX - 1,
            seconds => now + u64::from(seconds) * 1_000_000,
        };
        Some(session.expires)
    }

    /// Ends the sessions whose time has come.
    pub(super) fn expire(&mut self, now: u64) {
        for index in 0..self.sessions.len() {
            if self.sessions[index]
                .as_ref()
                .is_some_and(|session| session.connection.is_none() && session.expires <= now)
            {
                self.end_session(index);
            }
        }
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
