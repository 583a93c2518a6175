//! One connection, from CONNACK to its loss.

use core::cell::RefCell;
use core::convert::Infallible;

use crawler_hal::{Clock, Duration, Instant, LinkMonitor, LinkState, with_deadline};
use crawler_protocol::{Level, MAX_MESSAGE, Qos, TimeMessage, Topic};
use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use heapless::Vec;
use rust_mqtt::Bytes;
use rust_mqtt::client::Client;
use rust_mqtt::client::event::Event;
use rust_mqtt::client::options::{
    PublicationOptions, RetainHandling, SubscriptionOptions, TopicReference,
};
use rust_mqtt::header::FixedHeader;
use rust_mqtt::types::{MqttString, PacketIdentifier, TopicFilter, TopicName};

use super::buffered::Buffered;
use super::flow::{Flow, InFlight, Parcel, RECEIVE_WINDOW, SEND_WINDOW, SUBSCRIPTIONS};
use super::letter::{Letter, Mailbox};
use super::loss::Loss;
use super::{
    ACKNOWLEDGED_WITHIN, HEARTBEAT_PERIOD, LOST_AFTER, PING_AFTER, SUBSCRIBED_WITHIN,
    WRITTEN_WITHIN, messages,
};
use crate::context::{BootRecord, Robot};
use crate::parameters::Parameter;
use crate::perception::LinkHealth;

/// The client library as this link uses it: no topic aliases, no user properties.
pub(super) type Mqtt<'c, S> = Client<
    'c,
    'c,
    Buffered<S>,
    Mailbox<'c>,
    SUBSCRIPTIONS,
    RECEIVE_WINDOW,
    SEND_WINDOW,
    0,
    0,
    0,
    0,
>;

/// Log records sent before looking at the stream again.
const LOGS_AT_ONCE: usize = 2;

/// Counters of messages that live as long as the program.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) heartbeats: u64,
    pub(super) telemetry: u64,
}

/// See the [module](self).
pub(super) struct Connection<'a, 'c, M: RawMutex, C, L, S: Read + Write> {
    pub(super) robot: &'a Robot<M>,
    pub(super) clock: &'a C,
    pub(super) monitor: &'a L,
    pub(super) client: &'a mut Mqtt<'c, S>,
    pub(super) letter: &'c RefCell<Letter>,
    pub(super) scratch: &'a mut [u8; MAX_MESSAGE],
    pub(super) flow: &'a mut Flow,
    pub(super) counters: &'a mut Counters,
    pub(super) state: State,
}

/// What one connection keeps track of.
pub(super) struct State {
    opened: Instant,
    /// Last packet from the broker.
    heard: Instant,
    pinged: bool,
    unconfirmed: Vec<PacketIdentifier, SUBSCRIPTIONS>,
    /// When the last subscription was confirmed: since then commands arrive.
    pub(super) up_since: Option<Instant>,
    /// Boot record in the last status sent on this connection.
    told: Option<BootRecord>,
    parameters_due: bool,
    next_heartbeat: Instant,
    next_telemetry: Instant,
}

impl State {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            opened: now,
            heard: now,
            pinged: false,
            unconfirmed: Vec::new(),
            up_since: None,
            told: None,
            parameters_due: true,
            next_heartbeat: now,
            next_telemetry: now,
        }
    }
}

impl<M: RawMutex, C: Clock, L: LinkMonitor, S: Read + Write> Connection<'_, '_, M, C, L, S> {
    /// Keeps the session until it is lost. `resumed` says whether the broker remembered it.
    pub(super) async fn run(&mut self, resumed: bool) -> Loss {
        match self.serve(resumed).await {
            Ok(never) => match never {},
            Err(loss) => loss,
        }
    }

    async fn serve(&mut self, resumed: bool) -> Result<Infallible, Loss> {
        if resumed {
            self.retransmit().await?;
        } else {
            self.flow.in_flight.clear();
            self.robot.outbox.rewind();
        }
        self.subscribe().await?;
        let robot = self.robot;
        loop {
            let more = self.send_due().await?;
            let wake = if more {
                self.clock.now()
            } else {
                self.next_deadline()
            };
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
                    self.receive(header).await?;
                }
                Either4::Third(()) => self.state.parameters_due = true,
                Either4::Second(()) | Either4::Fourth(()) => {}
            }
        }
    }

    /// Sends once more, under its old number, what the broker has not acknowledged.
    async fn retransmit(&mut self) -> Result<(), Loss> {
        for index in 0..self.flow.in_flight.len() {
            let flight = self.flow.in_flight[index];
            let composed = self.compose(flight.parcel);
            let Some((topic, len)) = composed else {
                // A number that stays open for ever would block a place: begin a new session.
                self.flow.abandon();
                return Err(Loss::Unsupported);
            };
            let topic = topic.render(&self.robot.config().fleet);
            let options = publication(&topic, Qos::AtLeastOnce, flight.parcel.retained())?;
            let deadline = self.write_deadline();
            let message = Bytes::Borrowed(&self.scratch[..len]);
            let work = self.client.republish(flight.id, &options, message);
            match with_deadline(self.clock, deadline, work).await {
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

    async fn subscribe(&mut self) -> Result<(), Loss> {
        let config = self.robot.config();
        let topics = [
            Topic::CommandRobot(config.id.clone()),
            Topic::CommandSwarm,
            Topic::CommandExperiment,
            Topic::Time,
        ];
        for topic in &topics {
            let filter = topic.render(&config.fleet);
            let filter = MqttString::from_str(&filter)
                .ok()
                .and_then(TopicFilter::new)
                .ok_or(Loss::Unsupported)?;
            // A retained command would be given again at every connection, a retained time is
            // an old one.
            let mut options = SubscriptionOptions::new().retain_handling(RetainHandling::NeverSend);
            if topic.qos() == Qos::AtLeastOnce {
                options = options.at_least_once();
            }
            let deadline = self.write_deadline();
            let work = self.client.subscribe(filter, &options);
            let id = with_deadline(self.clock, deadline, work)
                .await
                .map_err(|_| Loss::Stalled)??;
            // As many places as topics.
            let _ = self.state.unconfirmed.push(id);
        }
        Ok(())
    }

    /// Sends whatever is due. `true` when there is more that could be sent at once.
    async fn send_due(&mut self) -> Result<bool, Loss> {
        self.check()?;
        let now = self.clock.now();
        if !self.state.pinged && now - self.state.heard >= PING_AFTER {
            let deadline = self.write_deadline();
            let work = self.client.ping();
            with_deadline(self.clock, deadline, work)
                .await
                .map_err(|_| Loss::Stalled)??;
            self.state.pinged = true;
        }
        while self.has_window()
            && let Some((ticket, _)) = self.robot.outbox.next_answer()
        {
            self.send(Parcel::Answer(ticket)).await?;
        }
        if self.state.up_since.is_some() {
            let boot = self.robot.boot();
            if self.state.told != Some(boot) && self.is_free_for(Parcel::Status) {
                self.send(Parcel::Status).await?;
                self.state.told = Some(boot);
            }
            if self.state.parameters_due && self.is_free_for(Parcel::Parameters) {
                self.state.parameters_due = false;
                self.send(Parcel::Parameters).await?;
            }
        }
        self.send_periodic().await?;
        for _ in 0..LOGS_AT_ONCE {
            let now = self.clock.now();
            let timestamp = self.robot.unix_ms(now).unwrap_or(0);
            let Some(entry) = self.robot.outbox.next_log(timestamp, now) else {
                return Ok(false);
            };
            if let Some(len) = messages::log(self.robot, &entry, self.scratch) {
                let topic = Topic::Logs(self.robot.config().id.clone());
                self.publish(&topic, len, None).await?;
            }
        }
        Ok(true)
    }

    async fn send_periodic(&mut self) -> Result<(), Loss> {
        let robot = self.robot;
        let now = self.clock.now();
        if now >= self.state.next_heartbeat {
            self.state.next_heartbeat = following(self.state.next_heartbeat, HEARTBEAT_PERIOD, now);
            let seq = self.counters.heartbeats;
            self.counters.heartbeats += 1;
            if let Some(len) = messages::heartbeat(robot, seq, now, self.scratch) {
                let topic = Topic::Heartbeat(robot.config().id.clone());
                self.publish(&topic, len, None).await?;
            }
        }
        let now = self.clock.now();
        if now >= self.state.next_telemetry {
            let period = telemetry_period(robot);
            self.state.next_telemetry = following(self.state.next_telemetry, period, now);
            let rssi_dbm = match self.monitor.state() {
                LinkState::Up { rssi_dbm, .. } => rssi_dbm,
                LinkState::Down => None,
            };
            let seq = self.counters.telemetry;
            self.counters.telemetry += 1;
            if let Some(len) = messages::telemetry(robot, seq, rssi_dbm, now, self.scratch) {
                let topic = Topic::Telemetry(robot.config().id.clone());
                self.publish(&topic, len, None).await?;
            }
        }
        Ok(())
    }

    async fn send(&mut self, parcel: Parcel) -> Result<(), Loss> {
        let Some((topic, len)) = self.compose(parcel) else {
            // Nothing here can make it fit later either.
            if let Parcel::Answer(ticket) = parcel {
                self.robot.outbox.delivered(ticket);
                self.robot.outbox.withheld();
            }
            let text = format_args!("{parcel:?} does not fit a message");
            let now = self.clock.now();
            self.robot.log(Level::Error, "message-too-large", text, now);
            return Ok(());
        };
        self.publish(&topic, len, Some(parcel)).await
    }

    /// Writes a message to `scratch`; its topic and length.
    fn compose(&mut self, parcel: Parcel) -> Option<(Topic, usize)> {
        let robot = self.robot;
        let id = robot.config().id.clone();
        Some(match parcel {
            Parcel::Status => {
                let len = messages::status(robot, true, robot.boot(), self.scratch)?;
                (Topic::Status(id), len)
            }
            Parcel::Parameters => {
                let len = messages::parameters(robot, self.scratch)?;
                (Topic::Parameters(id), len)
            }
            Parcel::Answer(ticket) => {
                let answer = robot.outbox.get(ticket)?;
                let len = messages::response(robot, answer, self.scratch)?;
                (Topic::Response(id), len)
            }
        })
    }

    /// Publishes the first `len` bytes of `scratch`. Not to be dropped half-way.
    async fn publish(
        &mut self,
        topic: &Topic,
        len: usize,
        parcel: Option<Parcel>,
    ) -> Result<(), Loss> {
        let name = topic.render(&self.robot.config().fleet);
        let options = publication(&name, topic.qos(), topic.retained())?;
        self.flow.sending = parcel;
        let deadline = self.write_deadline();
        let message = Bytes::Borrowed(&self.scratch[..len]);
        let work = self.client.publish(&options, message);
        let id = with_deadline(self.clock, deadline, work)
            .await
            .map_err(|_| Loss::Stalled)??;
        self.flow.sending = None;
        if let (Some(id), Some(parcel)) = (id, parcel) {
            let sent = self.clock.now();
            // There is a place: `has_window` said so.
            let _ = self.flow.in_flight.push(InFlight { id, parcel, sent });
            if let Parcel::Answer(ticket) = parcel {
                self.robot.outbox.sent(ticket);
            }
        }
        Ok(())
    }

    async fn receive(&mut self, header: FixedHeader) -> Result<(), Loss> {
        self.letter.borrow_mut().clear();
        let deadline = self.write_deadline();
        let work = self.client.poll_body(header);
        let event = with_deadline(self.clock, deadline, work)
            .await
            .map_err(|_| Loss::Stalled)??;
        let now = self.clock.now();
        self.state.heard = now;
        self.state.pinged = false;
        match event {
            Event::Publish(_) => self.open_letter(now),
            Event::Suback(ack) => {
                if ack.reason_code.is_erroneous() {
                    return Err(Loss::NotSubscribed);
                }
                let confirmed = ack.packet_identifier;
                self.state.unconfirmed.retain(|id| *id != confirmed);
                if self.state.unconfirmed.is_empty() && self.state.up_since.is_none() {
                    self.state.up_since = Some(now);
                    self.robot.set_link_health(LinkHealth::Up);
                }
            }
            Event::PublishAcknowledged(ack) => {
                if let Some(Parcel::Answer(ticket)) = self.flow.settle(ack.packet_identifier) {
                    self.robot.outbox.delivered(ticket);
                }
            }
            Event::PublishRejected(ack) => {
                // For good: sent again it would be rejected again.
                if let Some(Parcel::Answer(ticket)) = self.flow.settle(ack.packet_identifier) {
                    self.robot.outbox.delivered(ticket);
                }
                let reason = ack.reason_code.value();
                let text = format_args!("the broker rejected a message with 0x{reason:02x}");
                self.robot.log(Level::Error, "publish-rejected", text, now);
            }
            _ => {}
        }
        Ok(())
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
                    robot.time.observe(message.timestamp, now);
                }
            }
            // Not what we subscribed to.
            Some(_) | None => {}
        }
    }

    /// Whether the session must be given up.
    fn check(&self) -> Result<(), Loss> {
        let now = self.clock.now();
        if self.monitor.state() == LinkState::Down {
            return Err(Loss::NetworkDown);
        }
        if now >= self.state.heard + LOST_AFTER {
            return Err(Loss::Silent);
        }
        if !self.state.unconfirmed.is_empty() && now >= self.state.opened + SUBSCRIBED_WITHIN {
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
        if let Some(sent) = self.flow.oldest() {
            wake = wake.min(sent + ACKNOWLEDGED_WITHIN);
        }
        wake
    }

    /// No transfer may take longer, so that no stalled stream delays the verdict on a silent
    /// broker by more than [`WRITTEN_WITHIN`].
    fn write_deadline(&self) -> Instant {
        let now = self.clock.now();
        (now + WRITTEN_WITHIN)
            .min((self.state.heard + LOST_AFTER).max(now + Duration::from_secs(1)))
    }

    fn has_window(&self) -> bool {
        let granted = usize::from(self.client.server_config().receive_maximum.get());
        self.flow.in_flight.len() < granted.min(SEND_WINDOW)
    }

    fn is_free_for(&self, parcel: Parcel) -> bool {
        self.has_window() && !self.flow.is_in_flight(parcel)
    }
}

/// The beat after `due`: on time while we keep up, and skipping what was missed when we do not.
fn following(due: Instant, period: Duration, now: Instant) -> Instant {
    let next = due + period;
    if next > now { next } else { now + period }
}

fn telemetry_period<M: RawMutex>(robot: &Robot<M>) -> Duration {
    let hz = robot.with_parameters(|parameters| parameters.number(Parameter::TelemetryRate));
    // The table keeps the rate within its range; the bounds here are only for the division.
    Duration::from_micros((1e6 / hz.clamp(0.1, 100.0)) as u64)
}

fn publication(topic: &str, qos: Qos, retained: bool) -> Result<PublicationOptions<'_>, Loss> {
    let name = MqttString::from_str(topic)
        .ok()
        .and_then(TopicName::new)
        .ok_or(Loss::Unsupported)?;
    let mut options = PublicationOptions::new(TopicReference::Name(name));
    if qos == Qos::AtLeastOnce {
        options = options.at_least_once();
    }
    if retained {
        options = options.retain();
    }
    Ok(options)
}
