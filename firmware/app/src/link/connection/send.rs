//! What one connection sends, and when.

use core::pin::pin;

use crawler_hal::{Clock, LinkMonitor, with_deadline};
use crawler_protocol::{Level, Qos, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use rust_mqtt::Bytes;
use rust_mqtt::client::options::{RetainHandling, SubscriptionOptions};
use rust_mqtt::types::{MqttString, TopicFilter};

use super::publish::publication;
use super::{Connection, following};
use crate::hold::Hold;
use crate::link::flow::MessageKind;
use crate::link::limits::{HEARTBEAT_PERIOD, PING_AFTER};
use crate::link::loss::Loss;
use crate::link::messages;
use crate::update::ReportKind;

/// Log records sent before looking at the stream again.
const LOGS_AT_ONCE: usize = 2;

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Sends once more, under its old number, what the broker has not acknowledged.
    // Nothing is received while something is written, so nothing else wants the packet.
    #[allow(clippy::await_holding_refcell_ref)]
    pub(in crate::link) async fn retransmit(&mut self) -> Result<(), Loss> {
        for index in 0..self.flow.in_flight.len() {
            let flight = self.flow.in_flight[index];
            if flight.kind == MessageKind::Image {
                self.send_image(Some(flight.id)).await?;
                self.flow.in_flight[index].sent = self.clock.now();
                continue;
            }
            let composed = self.compose(flight.kind);
            let Some((topic, len)) = composed else {
                // A number that stays open for ever would block a place: begin a new session.
                self.flow.abandon();
                return Err(Loss::Unsupported);
            };
            let topic = topic.render(&self.robot.config().fleet);
            let options = publication(&topic, Qos::AtLeastOnce, flight.kind.retained())?;
            let deadline = self.write_deadline();
            let packet = self.packet.borrow();
            let message = Bytes::Borrowed(packet.draft(len));
            let written = {
                let work = pin!(self.client.republish(flight.id, &options, message));
                with_deadline(self.clock, deadline, work).await
            };
            match written {
                Ok(Ok(())) => self.flow.in_flight[index].sent = self.clock.now(),
                Ok(Err(error)) => {
                    if error.is_recoverable() {
                        self.flow.abandon();
                    }
                    return Err(error.into());
                }
                Err(_) => return Err(Loss::Stalled),
            }
        }
        Ok(())
    }

    pub(in crate::link) async fn subscribe(&mut self) -> Result<(), Loss> {
        let config = self.robot.config();
        let topics = [
            Topic::CommandRobot(config.id.clone()),
            Topic::CommandSwarm,
            Topic::CommandExperiment,
            Topic::Time,
            Topic::Pose(config.id.clone()),
        ];
        let more = config.takes_faults().then_some(Topic::SimulatorCommand);
        let updates = self.updates.exists();
        let updates = updates.then(|| Topic::Ota(config.id.clone()));
        for topic in topics.iter().chain(&more).chain(&updates) {
            let filter = topic.render(&config.fleet);
            let filter = MqttString::from_str(&filter)
                .ok()
                .and_then(TopicFilter::new)
                .ok_or(Loss::Unsupported)?;
            // A retained command would be given again at every connection; a retained time or
            // fix is an old one.
            let mut options = SubscriptionOptions::new().retain_handling(RetainHandling::NeverSend);
            if topic.qos() == Qos::AtLeastOnce {
                options = options.at_least_once();
            }
            if let Topic::Ota(_) = topic {
                // The robot's own reports go there too.
                options = options.no_local();
            }
            let deadline = self.write_deadline();
            let id = {
                let work = pin!(self.client.subscribe(filter, &options));
                let written = with_deadline(self.clock, deadline, work).await;
                written.map_err(|_| Loss::Stalled)??
            };
            // As many places as topics.
            let _ = self.state.unconfirmed.push(id);
        }
        Ok(())
    }

    /// Sends whatever is due. `true` when there is more that could be sent at once.
    pub(in crate::link) async fn send_due(&mut self) -> Result<bool, Loss> {
        self.check()?;
        let now = self.clock.now();
        if !self.state.pinged && now - self.state.heard >= PING_AFTER {
            self.ping().await?;
            self.state.pinged = true;
        }
        while self.has_window()
            && let Some((ticket, _)) = self.robot.outbox.next_answer()
        {
            self.send(MessageKind::Answer(ticket)).await?;
        }
        self.follow_cells().await?;
        if self.state.up_since.is_some() {
            let boot = self.robot.boot();
            let news = self.updates.models_revision().map(|models| (boot, models));
            let is_news = news.is_some() && self.state.told != news;
            if is_news && self.is_free_for(MessageKind::Status) {
                self.state.told = news;
                self.send(MessageKind::Status).await?;
            }
            if self.state.parameters_due && self.is_free_for(MessageKind::Parameters) {
                self.state.parameters_due = false;
                self.send(MessageKind::Parameters).await?;
            }
            while self.has_window()
                && let Some(kind) = self.next_report()
            {
                self.send(MessageKind::Update(kind)).await?;
            }
            if self.is_free_for(MessageKind::Image) && self.images.waits() {
                self.send_image(None).await?;
            }
        }
        self.send_periodic().await?;
        if self.state.up_since.is_some() && self.robot.has_news() {
            self.send_detections().await?;
        }
        if self.state.up_since.is_some() && self.robot.map_waits() {
            self.send_map().await?;
        }
        for _ in 0..LOGS_AT_ONCE {
            let now = self.clock.now();
            let timestamp = self.robot.unix_ms(now).unwrap_or(0);
            let Some(entry) = self.robot.outbox.next_log(timestamp, now) else {
                // One question at a time, or an answer would not tell which it answers.
                if self.state.pings == 0 && self.robot.outbox.logs_unproven() {
                    self.ping().await?;
                }
                return Ok(false);
            };
            let written = self.write(|page| messages::log(self.robot, &entry, page));
            if let Some(len) = written {
                let topic = Topic::Logs(self.robot.config().id.clone());
                self.publish(&topic, len, None, None).await?;
            }
        }
        Ok(true)
    }

    fn next_report(&self) -> Option<ReportKind> {
        let free = |kind| !self.flow.is_in_flight(MessageKind::Update(kind));
        self.updates.next_report(&free)
    }

    /// Asks the broker for an answer, which proves that what was sent before has arrived.
    async fn ping(&mut self) -> Result<(), Loss> {
        if self.state.pings == 0 {
            self.robot.outbox.logs_asked();
        }
        self.state.pings = self.state.pings.saturating_add(1);
        let deadline = self.write_deadline();
        let work = pin!(self.client.ping());
        with_deadline(self.clock, deadline, work)
            .await
            .map_err(|_| Loss::Stalled)??;
        Ok(())
    }

    async fn send_periodic(&mut self) -> Result<(), Loss> {
        let robot = self.robot;
        let now = self.clock.now();
        if now >= self.state.next_heartbeat {
            self.state.next_heartbeat = following(self.state.next_heartbeat, HEARTBEAT_PERIOD, now);
            let seq = self.counters.heartbeats;
            self.counters.heartbeats += 1;
            if let Some(len) = self.write(|page| messages::heartbeat(robot, seq, now, page)) {
                let topic = Topic::Heartbeat(robot.config().id.clone());
                self.publish(&topic, len, None, None).await?;
            }
        }
        self.send_telemetry().await
    }

    async fn send_detections(&mut self) -> Result<(), Loss> {
        let robot = self.robot;
        let now = self.clock.now();
        let seq = self.counters.detections;
        if let Some(len) = self.write(|page| messages::detections(robot, seq, now, page)) {
            self.counters.detections += 1;
            let topic = Topic::Vision(robot.config().id.clone());
            self.publish(&topic, len, None, None).await?;
        }
        Ok(())
    }

    /// Sends the part of the map that waits. One that does not fit would not fit later either.
    async fn send_map(&mut self) -> Result<(), Loss> {
        let robot = self.robot;
        if let Some(len) = self.write(|page| messages::map(robot, self.clock.now(), page)) {
            let topic = Topic::Map(robot.config().id.clone());
            self.publish(&topic, len, None, None).await?;
        }
        robot.link_handle().map_sent(self.clock.now());
        Ok(())
    }

    async fn send(&mut self, kind: MessageKind) -> Result<(), Loss> {
        let Some((topic, len)) = self.compose(kind) else {
            // Nothing here can make it fit later either.
            if let MessageKind::Answer(ticket) = kind {
                self.robot.outbox.delivered(ticket);
                self.robot.outbox.withheld();
            }
            if let MessageKind::Update(kind) = kind {
                self.updates.settled(kind);
            }
            let text = format_args!("{kind:?} does not fit a message");
            let now = self.clock.now();
            self.robot.log(Level::Error, "message-too-large", text, now);
            return Ok(());
        };
        self.publish(&topic, len, Some(kind), None).await
    }
}
