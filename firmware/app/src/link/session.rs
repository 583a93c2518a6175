//! One connection, from CONNACK to its loss.

use core::cell::RefCell;
use core::convert::Infallible;
use core::pin::pin;

use crawler_hal::{Clock, Instant, LinkMonitor, LinkState, with_deadline};
use crawler_protocol::{Level, TimeMessage, Topic};
use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use heapless::Vec;
use rust_mqtt::client::Client;
use rust_mqtt::client::event::Event;
use rust_mqtt::header::FixedHeader;
use rust_mqtt::types::PacketIdentifier;

use super::buffered::Buffered;
use super::cells::Asked;
use super::flow::{Flow, MessageKind, RECEIVE_WINDOW, SEND_WINDOW, SUBSCRIPTIONS};
use super::images::Images;
use super::letter::{Letter, Mailbox};
use super::loss::Loss;
use super::telemetry::Batch;
use super::{ACKNOWLEDGED_WITHIN, LOST_AFTER, PING_AFTER, SUBSCRIBED_WITHIN};
use crate::camera::Outcome;
use crate::context::{BootRecord, Robot};
use crate::hold::Hold;
use crate::perception::LinkHealth;

/// User properties of an image.
const USER_PROPERTIES: usize = 2;

/// The client library as this link uses it: no topic aliases.
pub(super) type Mqtt<'c, S, H> = Client<
    'c,
    'c,
    &'c mut Buffered<S, H>,
    Mailbox<'c, H>,
    SUBSCRIPTIONS,
    RECEIVE_WINDOW,
    SEND_WINDOW,
    0,
    USER_PROPERTIES,
    0,
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
    pub(super) letter: &'c RefCell<Letter<H>>,
    pub(super) flow: &'a mut Flow,
    pub(super) counters: &'a mut Counters,
    pub(super) images: &'a mut dyn Images,
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
    /// Boot record in the last status sent on this connection.
    pub(super) told: Option<BootRecord>,
    pub(super) parameters_due: bool,
    /// A cell that the broker was asked about.
    pub(super) asked: Option<Asked>,
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
            asked: None,
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
    /// Keeps the session until it is lost. `resumed` says whether the broker remembered it.
    pub(super) async fn serve(&mut self, resumed: bool) -> Result<Infallible, Loss> {
        if resumed {
            H::hold(self.retransmit()).await?;
        } else {
            self.flow.in_flight.clear();
            self.flow.cells.forget();
            self.robot.outbox.rewind();
        }
        H::hold(self.subscribe()).await?;
        let robot = self.robot;
        loop {
            let more = H::hold(self.send_due()).await?;
            let wake = if more {
                self.clock.now()
            } else {
                self.next_deadline()
            };
            self.letter.borrow_mut().discard();
            // Only `poll_header` may be dropped half-way; what follows it runs to its end.
            let event = select4(
                self.client.poll_header(),
                robot.outbox.changed(),
                robot.parameters_changed.wait(),
                self.clock.sleep_until(wake),
            )
            .await;
            match event {
                Either4::First(header) => {
                    let header = header?;
                    H::hold(self.receive(header)).await?;
                }
                Either4::Third(()) => self.state.parameters_due = true,
                Either4::Second(()) | Either4::Fourth(()) => {}
            }
        }
    }

    async fn receive(&mut self, header: FixedHeader) -> Result<(), Loss> {
        self.letter.borrow_mut().clear();
        let deadline = self.write_deadline();
        let event = {
            let work = pin!(self.client.poll_body(header));
            let outcome = with_deadline(self.clock, deadline, work).await;
            outcome.map_err(|_| Loss::Stalled)??
        };
        let now = self.clock.now();
        self.state.heard = now;
        self.state.pinged = false;
        match event {
            Event::Publish(_) => self.open_letter(now),
            Event::Suback(ack) => {
                let confirmed = ack.packet_identifier;
                let refused = ack.reason_code.is_erroneous();
                self.cell_answered(confirmed, refused, now);
                if refused && self.state.unconfirmed.contains(&confirmed) {
                    return Err(Loss::NotSubscribed);
                }
                self.state.unconfirmed.retain(|id| *id != confirmed);
                if self.state.unconfirmed.is_empty() && self.state.up_since.is_none() {
                    self.state.up_since = Some(now);
                    self.robot.set_link_health(LinkHealth::Up);
                    self.robot.set_link_trouble(None);
                }
            }
            Event::Unsuback(ack) => self.cell_answered(ack.packet_identifier, false, now),
            Event::Pingresp => {
                self.state.pings = self.state.pings.saturating_sub(1);
                self.robot.outbox.logs_proven();
            }
            Event::PublishAcknowledged(ack) => {
                self.settle(ack.packet_identifier, Outcome::Delivered);
            }
            Event::PublishRejected(ack) => {
                // For good: sent again it would be rejected again.
                self.settle(ack.packet_identifier, Outcome::Refused);
                let reason = ack.reason_code.value();
                let text = format_args!("the broker rejected a message with 0x{reason:02x}");
                self.robot.log(Level::Error, "publish-rejected", text, now);
            }
            _ => {}
        }
        Ok(())
    }

    /// Nothing more is to be done for the message under this number.
    fn settle(&mut self, id: PacketIdentifier, outcome: Outcome) {
        match self.flow.settle(id) {
            Some(MessageKind::Answer(ticket)) => self.robot.outbox.delivered(ticket),
            Some(MessageKind::Image) => self.images.settle(outcome),
            Some(MessageKind::Status | MessageKind::Parameters) | None => {}
        }
    }

    fn open_letter(&mut self, now: Instant) {
        let robot = self.robot;
        let config = robot.config();
        let letter = self.letter.borrow();
        let topic = core::str::from_utf8(letter.topic())
            .ok()
            .and_then(|topic| Topic::parse(&config.fleet, topic).ok());
        match topic {
            Some(Topic::CommandRobot(id)) if id == config.id => robot.submit(letter.payload(), now),
            Some(Topic::CommandSwarm | Topic::CommandExperiment) => {
                robot.submit(letter.payload(), now);
            }
            Some(Topic::Time) => {
                if let Ok(message) = TimeMessage::from_json(letter.payload()) {
                    robot.observe_time(message.timestamp, now);
                }
            }
            Some(Topic::Pose(id)) if id == config.id => {
                // Refusals are counted and logged there.
                let _ = robot.observe_fix(letter.payload(), now);
            }
            Some(Topic::Cell { x, y }) => {
                robot.observe_cell((x, y), letter.payload(), now);
            }
            #[cfg(feature = "faults")]
            Some(Topic::SimulatorCommand) => robot.obey_simulator(letter.payload(), now),
            // Not what we subscribed to.
            Some(_) | None => {}
        }
    }

    /// Whether the session must be given up.
    pub(super) fn check(&self) -> Result<(), Loss> {
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

    fn next_deadline(&self) -> Instant {
        let state = &self.state;
        let patience = if state.pinged { LOST_AFTER } else { PING_AFTER };
        let mut wake = state.heard + patience;
        wake = wake.min(state.next_heartbeat).min(state.next_telemetry);
        if !state.unconfirmed.is_empty() {
            wake = wake.min(state.opened + SUBSCRIBED_WITHIN);
        }
        if let Some(due) = self.cells_due() {
            wake = wake.min(due);
        }
        if let Some(sent) = self.flow.oldest() {
            wake = wake.min(sent + ACKNOWLEDGED_WITHIN);
        }
        wake
    }
}
