//! What outlives a connection: the MQTT session, and which message travels under which number.

use crawler_hal::Instant;
use heapless::Vec;
use rust_mqtt::session::Session;
use rust_mqtt::types::PacketIdentifier;

use super::cells::Cells;
use crate::outbox::Ticket;
use crate::update::ReportKind;

/// SUBSCRIBE packets that may wait for their acknowledgement at a time.
pub(super) const SUBSCRIPTIONS: usize = if cfg!(feature = "faults") { 7 } else { 6 };
/// QoS 1 messages the broker may send before we have acknowledged the first of them.
pub(super) const RECEIVE_WINDOW: usize = 4;
/// QoS 1 messages we send before the broker has acknowledged the first of them.
pub(super) const SEND_WINDOW: usize = 8;

/// Topics for which the broker may send a number instead: the one of updates is as long as all else around a chunk.
pub(super) const ALIASES: usize = 1;

/// The client library's record of a session, as this link uses it.
pub(super) type MqttSession = Session<SUBSCRIPTIONS, RECEIVE_WINDOW, SEND_WINDOW, ALIASES, 0>;

/// A QoS 1 message, by what it is rather than by its bytes: sent again, it is composed again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MessageKind {
    /// The retained status.
    Status,
    /// The retained parameters.
    Parameters,
    /// An answer in the outbox.
    Answer(Ticket),
    /// The image that the link holds: one at a time.
    Image,
    /// What the robot says about updates.
    Update(ReportKind),
}

impl MessageKind {
    /// Whether the broker keeps the message for later subscribers.
    pub(super) const fn retained(self) -> bool {
        match self {
            Self::Status | Self::Parameters => true,
            Self::Answer(_) | Self::Image | Self::Update(_) => false,
        }
    }
}

/// A QoS 1 message on its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct InFlight {
    pub(super) id: PacketIdentifier,
    pub(super) kind: MessageKind,
    pub(super) sent: Instant,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Flow {
    /// The session as of the last connection; `None` before the first one, and when it cannot be
    /// continued. The next connection then asks for a clean start.
    pub(super) session: Option<MqttSession>,
    pub(super) in_flight: Vec<InFlight, SEND_WINDOW>,
    /// Being written. If the connection breaks meanwhile, the session knows a number for it that
    /// we were not told.
    pub(super) sending: Option<MessageKind>,
    /// Which cells the broker sends.
    pub(super) cells: Cells,
    abandoned: bool,
}

impl Flow {
    pub(super) const fn new() -> Self {
        Self {
            session: None,
            in_flight: Vec::new(),
            sending: None,
            cells: Cells::new(),
            abandoned: false,
        }
    }

    /// Makes the next connection ask for a new session.
    pub(super) const fn abandon(&mut self) {
        self.abandoned = true;
    }

    /// Takes over the session of a connection that has ended.
    pub(super) fn keep(&mut self, mut session: MqttSession, now: Instant) {
        if core::mem::take(&mut self.abandoned) {
            self.sending = None;
            self.session = None;
            return;
        }
        for (id, _) in &session.outbound_publishes {
            if self.in_flight.iter().any(|flight| flight.id == *id) {
                continue;
            }
            if let Some(kind) = self.sending.take() {
                // The library has a number for at most as many as there are places here.
                let _ = self.in_flight.push(InFlight {
                    id: *id,
                    kind,
                    sent: now,
                });
            }
        }
        self.sending = None;
        let known = |id| self.in_flight.iter().any(|flight| flight.id == id);
        session.outbound_publishes.retain(|(id, _)| known(*id));
        self.session = Some(session);
    }

    /// Notes that the broker has a message, or has refused it for good.
    pub(super) fn settle(&mut self, id: PacketIdentifier) -> Option<MessageKind> {
        let index = self.in_flight.iter().position(|flight| flight.id == id)?;
        Some(self.in_flight.remove(index).kind)
    }

    pub(super) fn is_in_flight(&self, kind: MessageKind) -> bool {
        self.in_flight.iter().any(|flight| flight.kind == kind)
    }

    /// When the message that waits longest for its acknowledgement was sent.
    pub(super) fn oldest(&self) -> Option<Instant> {
        self.in_flight.iter().map(|flight| flight.sent).min()
    }
}
