//! One connection, from CONNACK to its loss.

use core::convert::Infallible;
use core::pin::pin;

use crawler_hal::{Clock, Elapsed, Instant, LinkMonitor, with_deadline};
use crawler_protocol::{Level, TimeMessage, Topic};
use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use rust_mqtt::client::event::Event;
use rust_mqtt::client::options::TopicReference;
use rust_mqtt::header::FixedHeader;
use rust_mqtt::types::PacketIdentifier;

use super::connection::Connection;
use super::flow::MessageKind;
use super::limits::{ACKNOWLEDGED_WITHIN, LOST_AFTER, PING_AFTER, ROOM_WITHIN, SUBSCRIBED_WITHIN};
use super::loss::Loss;
use crate::camera::Outcome;
use crate::hold::Hold;
use crate::perception::LinkHealth;
use crate::update::room;

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
            self.updates.rewind();
        }
        H::hold(self.subscribe()).await?;
        let (robot, updates) = (self.robot, self.updates);
        loop {
            let more = H::hold(self.send_due()).await?;
            let wake = if more {
                self.clock.now()
            } else {
                self.next_deadline()
            };
            self.packet.borrow_mut().discard();
            let (clock, room_by) = (self.clock, self.room_by());
            // Only `poll_header` may be dropped half-way; what follows it runs to its end.
            let event = select4(
                async {
                    // What comes waits until there is a place for it, and time goes on meanwhile.
                    let _: Result<(), Elapsed> = with_deadline(clock, room_by, room(updates)).await;
                    self.client.poll_header().await
                },
                robot.outbox.changed(),
                robot.link_handle().parameters_changed(),
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

    /// Until when what comes may wait for a place.
    fn room_by(&mut self) -> Instant {
        let now = self.clock.now();
        if self.updates.has_room() {
            self.state.occupied_since = None;
            return now;
        }
        *self.state.occupied_since.get_or_insert(now) + ROOM_WITHIN
    }

    async fn receive(&mut self, header: FixedHeader) -> Result<(), Loss> {
        self.packet.borrow_mut().clear();
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
            Event::Publish(publish) => {
                let topic = match publish.topic {
                    TopicReference::Alias(_) => self.state.alias.clone(),
                    TopicReference::Mapping(..) => {
                        self.state.alias = self.topic();
                        self.state.alias.clone()
                    }
                    TopicReference::Name(_) => self.topic(),
                };
                self.open_letter(topic, now);
            }
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
                    let own = self.robot.link_handle();
                    own.set_health(LinkHealth::Up);
                    own.set_trouble(None);
                    self.updates.session_began();
                }
            }
            Event::Unsuback(ack) => self.cell_answered(ack.packet_identifier, false, now),
            Event::Pingresp => {
                self.state.pings = self.state.pings.saturating_sub(1);
                self.robot.outbox.logs_proven();
            }
            Event::PublishAcknowledged(ack) => {
                self.updates.reached();
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
            Some(MessageKind::Update(kind)) => self.updates.settled(kind),
            Some(MessageKind::Status | MessageKind::Parameters) | None => {}
        }
    }

    /// The topic of a message that came with one.
    fn topic(&self) -> Option<Topic> {
        let packet = self.packet.borrow();
        let topic = core::str::from_utf8(packet.topic()).ok()?;
        Topic::parse(&self.robot.config().fleet, topic).ok()
    }

    fn open_letter(&mut self, topic: Option<Topic>, now: Instant) {
        let robot = self.robot;
        let config = robot.config();
        let packet = self.packet.borrow();
        if matches!(
            topic,
            Some(
                Topic::CommandRobot(_)
                    | Topic::CommandSwarm
                    | Topic::CommandExperiment
                    | Topic::Time
            )
        ) {
            self.updates.heard();
        }
        match topic {
            Some(Topic::CommandRobot(id)) if id == config.id => robot.submit(packet.payload(), now),
            Some(Topic::CommandSwarm | Topic::CommandExperiment) => {
                robot.submit(packet.payload(), now);
            }
            Some(Topic::Time) => {
                if let Ok(message) = TimeMessage::from_json(packet.payload()) {
                    robot.observe_time(message.timestamp, now);
                }
            }
            Some(Topic::Pose(id)) if id == config.id => {
                // Refusals are counted and logged there.
                let _ = robot.observe_fix(packet.payload(), now);
            }
            Some(Topic::Cell { x, y }) => {
                robot.observe_cell((x, y), packet.payload(), now);
            }
            Some(Topic::Ota(id)) if id == config.id => {
                if let Err(why) = self.updates.arrived(packet.payload()) {
                    robot.log(Level::Warn, "update", format_args!("{why}"), now);
                }
            }
            #[cfg(feature = "faults")]
            Some(Topic::SimulatorCommand) => robot.obey_simulator(packet.payload(), now),
            // Not what we subscribed to.
            Some(_) | None => {}
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
