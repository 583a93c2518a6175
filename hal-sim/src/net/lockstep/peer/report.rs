//! What a broker tells of its work.

use std::rc::Rc;

use crawler_hal::Instant;

use super::MAX_FILTERS;
use crate::net::lockstep::packet::PacketError;

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
    /// The client gave the wrong name or password, or none.
    NotAuthorized,
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
            Self::NotAuthorized => f.write_str("wrong name or password"),
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

impl PeerStatistics {
    /// Adds those of the broker of another shard.
    pub(crate) fn add(&mut self, other: &Self) {
        let Self {
            received,
            sent,
            dropped,
            unrecorded,
            faults,
        } = other;
        self.received += received;
        self.sent += sent;
        self.dropped += dropped;
        self.unrecorded += unrecorded;
        self.faults += faults;
    }
}
