//! A connection to the broker: what it holds, and when it is over.
//!
//! What it does lies in one file each: `publish` writes one message, `telemetry`, `images` and
//! `cells` send and ask what their names say, `send` decides what is due. Receiving, and the order
//! of it all, is in [`session`](super::session).

mod cells;
mod images;
mod publish;
mod send;
mod telemetry;

use core::cell::RefCell;

use crawler_hal::{Clock, Duration, Instant, LinkMonitor, LinkState};
use crawler_protocol::Topic;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use heapless::Vec;
use rust_mqtt::client::Client;
use rust_mqtt::types::PacketIdentifier;

use super::batch::Batch;
use super::buffered::Buffered;
use super::cells::Asked;
use super::flow::{ALIASES, Flow, RECEIVE_WINDOW, SEND_WINDOW, SUBSCRIPTIONS};
use super::images::Images;
use super::limits::{ACKNOWLEDGED_WITHIN, LOST_AFTER, SUBSCRIBED_WITHIN, WRITTEN_WITHIN};
use super::loss::Loss;
use super::packet::{BufferLender, PacketBuffer};
use crate::context::{BootRecord, Robot};
use crate::hold::Hold;
use crate::update::UpdatePort;

/// User properties of an image.
const USER_PROPERTIES: usize = 2;

/// The client library as this link uses it: one topic alias on the way in, none on the way out.
pub(super) type Mqtt<'c, S, H> = Client<
    'c,
    'c,
    &'c mut Buffered<S, H>,
    BufferLender<'c, H>,
    SUBSCRIPTIONS,
    RECEIVE_WINDOW,
    SEND_WINDOW,
    0,
    USER_PROPERTIES,
    ALIASES,
    0,
>;

/// Counters of messages that live as long as the program.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) heartbeats: u64,
    pub(super) detections: u64,
    pub(super) telemetry: u64,
}

/// See the [module](self).
pub(super) struct Connection<'a, 'c, H: Hold, M: RawMutex, C, L, S: Read + Write> {
    pub(super) robot: &'a Robot<M>,
    pub(super) clock: &'a C,
    pub(super) monitor: &'a L,
    pub(super) client: &'a mut Mqtt<'c, S, H>,
    pub(super) packet: &'c RefCell<PacketBuffer<H>>,
    pub(super) flow: &'a mut Flow,
    pub(super) counters: &'a mut Counters,
    pub(super) images: &'a mut dyn Images,
    pub(super) updates: &'a dyn UpdatePort,
    pub(super) batch: &'a mut Batch<H>,
    pub(super) state: State,
}

/// What one connection keeps track of.
pub(super) struct State {
    pub(super) opened: Instant,
    /// Last packet from the broker.
    pub(super) heard: Instant,
    pub(super) pinged: bool,
    /// Pings not answered yet.
    pub(super) pings: u8,
    pub(super) unconfirmed: Vec<PacketIdentifier, SUBSCRIPTIONS>,
    /// When the last subscription was confirmed: since then commands arrive.
    pub(super) up_since: Option<Instant>,
    /// Boot record in the last status sent on this connection, and the revision of the models in it.
    pub(super) told: Option<(BootRecord, u8)>,
    pub(super) parameters_due: bool,
    /// The topic for which the broker has given a number; `None` as well for one that is none of ours.
    pub(super) alias: Option<Topic>,
    /// A cell that the broker was asked about.
    pub(super) asked: Option<Asked>,
    /// Since when there is no place for a chunk of a release.
    pub(super) occupied_since: Option<Instant>,
    /// The broker refused to send one.
    pub(super) no_cells: bool,
    pub(super) next_heartbeat: Instant,
    pub(super) next_telemetry: Instant,
}

impl State {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            opened: now,
            heard: now,
            pinged: false,
            pings: 0,
            unconfirmed: Vec::new(),
            up_since: None,
            told: None,
            parameters_due: true,
            alias: None,
            asked: None,
            occupied_since: None,
            no_cells: false,
            next_heartbeat: now,
            next_telemetry: now,
        }
    }
}

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Whether the session must be given up.
    fn check(&self) -> Result<(), Loss> {
        let now = self.clock.now();
        if self.monitor.state() == LinkState::Down {
            return Err(Loss::NetworkDown);
        }
        if let Some(how) = self.robot.injected.link(now) {
            return Err(Loss::injected(how));
        }
        if now >= self.state.heard + LOST_AFTER {
            return Err(Loss::Silent);
        }
        if !self.state.unconfirmed.is_empty() && now >= self.state.opened + SUBSCRIBED_WITHIN {
            return Err(Loss::NotSubscribed);
        }
        if self.cells_due().is_some_and(|due| now >= due) {
            return Err(Loss::NotSubscribed);
        }
        match self.flow.oldest() {
            Some(sent) if now >= sent + ACKNOWLEDGED_WITHIN => Err(Loss::Unacknowledged),
            Some(_) | None => Ok(()),
        }
    }

    /// When the answer to what was asked about cells is overdue.
    pub(super) fn cells_due(&self) -> Option<Instant> {
        self.state.asked.map(|asked| asked.at + SUBSCRIBED_WITHIN)
    }

    /// No transfer may take longer, so that no stalled stream delays the verdict on a silent
    /// broker by more than [`WRITTEN_WITHIN`].
    pub(super) fn write_deadline(&self) -> Instant {
        let now = self.clock.now();
        (now + WRITTEN_WITHIN)
            .min((self.state.heard + LOST_AFTER).max(now + Duration::from_secs(1)))
    }
}

/// The beat after `due`: on time while we keep up, and skipping what was missed when we do not.
fn following(due: Instant, period: Duration, now: Instant) -> Instant {
    let next = due + period;
    if next > now { next } else { now + period }
}
