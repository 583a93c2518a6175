//! Writing and publishing one message.

use core::pin::pin;

use crawler_hal::{Clock, LinkMonitor, with_deadline};
use crawler_protocol::{Qos, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use rust_mqtt::Bytes;
use rust_mqtt::client::options::{PublicationOptions, TopicReference};
use rust_mqtt::types::{MqttString, TopicName};

use super::Connection;
use crate::hold::Hold;
use crate::link::flow::{InFlight, MessageKind, SEND_WINDOW};
use crate::link::loss::Loss;
use crate::link::messages;

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Lets `compose` write a message to the page of the packet; its length.
    pub(super) fn write(&self, compose: impl FnOnce(&mut [u8]) -> Option<usize>) -> Option<usize> {
        compose(self.packet.borrow_mut().page())
    }

    /// Writes a message to the page of the packet; its topic and length. Images are not composed.
    pub(super) fn compose(&mut self, kind: MessageKind) -> Option<(Topic, usize)> {
        let robot = self.robot;
        let id = robot.config().id.clone();
        Some(match kind {
            MessageKind::Status => {
                let len = self.write(|page| messages::status(robot, self.updates, true, page))?;
                (Topic::Status(id), len)
            }
            MessageKind::Parameters => {
                let len = self.write(|page| messages::parameters(robot, page))?;
                (Topic::Parameters(id), len)
            }
            MessageKind::Answer(ticket) => {
                let answer = robot.outbox.get(ticket)?;
                let len = self.write(|page| messages::response(robot, answer, page))?;
                (Topic::Response(id), len)
            }
            MessageKind::Update(kind) => {
                let len = self.write(|page| self.updates.compose(kind, &id, page))?;
                (Topic::Ota(id), len)
            }
            MessageKind::Image => return None,
        })
    }

    /// Publishes the first `len` bytes of the page. Not to be dropped half-way.
    // Nothing is received while something is written, so nothing else wants the packet.
    #[allow(clippy::await_holding_refcell_ref)]
    pub(super) async fn publish(
        &mut self,
        topic: &Topic,
        len: usize,
        kind: Option<MessageKind>,
        content_type: Option<&str>,
    ) -> Result<(), Loss> {
        let name = topic.render(&self.robot.config().fleet);
        let mut options = publication(&name, topic.qos(), topic.retained())?;
        if let Some(content_type) = content_type {
            let text = MqttString::from_str(content_type).map_err(|_| Loss::Unsupported)?;
            options.content_type = Some(text);
        }
        self.flow.sending = kind;
        let deadline = self.write_deadline();
        let packet = self.packet.borrow();
        let message = Bytes::Borrowed(packet.draft(len));
        let id = {
            let work = pin!(self.client.publish(&options, message));
            let written = with_deadline(self.clock, deadline, work).await;
            written.map_err(|_| Loss::Stalled)??
        };
        self.flow.sending = None;
        if let (Some(id), Some(kind)) = (id, kind) {
            let sent = self.clock.now();
            // There is a place: `has_window` said so.
            let _ = self.flow.in_flight.push(InFlight { id, kind, sent });
            if let MessageKind::Answer(ticket) = kind {
                self.robot.outbox.sent(ticket);
            }
        }
        Ok(())
    }

    pub(super) fn has_window(&self) -> bool {
        let granted = usize::from(self.client.server_config().receive_maximum.get());
        self.flow.in_flight.len() < granted.min(SEND_WINDOW)
    }

    pub(super) fn is_free_for(&self, kind: MessageKind) -> bool {
        self.has_window() && !self.flow.is_in_flight(kind)
    }
}

pub(super) fn publication(
    topic: &str,
    qos: Qos,
    retained: bool,
) -> Result<PublicationOptions<'_>, Loss> {
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
