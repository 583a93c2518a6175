//! Sending an image. While its bytes are written nothing else travels, not even a command to this
//! robot: at most [`WRITTEN_WITHIN`](crate::link::WRITTEN_WITHIN).

use core::fmt::Write as _;
use core::pin::pin;

use crawler_hal::{Clock, LinkMonitor, with_deadline};
use crawler_protocol::{IMAGE_FRAME, IMAGE_TIMESTAMP, IMAGE_TYPE, Qos, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use heapless::String;
use rust_mqtt::Bytes;
use rust_mqtt::client::MqttError;
use rust_mqtt::types::{MqttString, MqttStringPair, PacketIdentifier};

use super::Connection;
use super::publish::publication;
use crate::camera::Outcome;
use crate::hold::Hold;
use crate::link::flow::{InFlight, MessageKind};
use crate::link::loss::Loss;

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Sends the image that is held: for the first time, or again under its old number. Not to
    /// be dropped half-way.
    pub(super) async fn send_image(&mut self, again: Option<PacketIdentifier>) -> Result<(), Loss> {
        let Some((jpeg, frame, timestamp)) = self.images.image() else {
            // A number that stays open for ever would block a place: begin a new session.
            self.flow.abandon();
            return Err(Loss::Unsupported);
        };
        let config = self.robot.config();
        let topic = Topic::Image(config.id.clone()).render(&config.fleet);
        let (frame, timestamp) = (decimal(u64::from(frame)), decimal(timestamp));
        let properties = [
            MqttStringPair::new(text(IMAGE_FRAME)?, text(&frame)?),
            MqttStringPair::new(text(IMAGE_TIMESTAMP)?, text(&timestamp)?),
        ];
        let mut options = publication(&topic, Qos::AtLeastOnce, false)?;
        options.user_properties = &properties;
        options.content_type = Some(text(IMAGE_TYPE)?);
        let deadline = self.write_deadline();
        let message = Bytes::Borrowed(jpeg);
        let written = if let Some(id) = again {
            let work = pin!(self.client.republish(id, &options, message));
            let written = with_deadline(self.clock, deadline, work).await;
            written.map(|result| result.map(|()| None))
        } else {
            self.flow.sending = Some(MessageKind::Image);
            let work = pin!(self.client.publish(&options, message));
            with_deadline(self.clock, deadline, work).await
        };
        let sent = self.clock.now();
        match written {
            Ok(Ok(id)) => {
                self.flow.sending = None;
                if let Some(id) = id {
                    let kind = MessageKind::Image;
                    // There is a place: whoever called made sure of it.
                    let _ = self.flow.in_flight.push(InFlight { id, kind, sent });
                }
                Ok(())
            }
            Ok(Err(MqttError::ServerMaximumPacketSizeExceeded)) => {
                // Nothing was written. What was promised under this number before cannot be kept.
                self.flow.sending = None;
                self.images.settle(Outcome::TooLarge);
                if again.is_some() {
                    self.flow.abandon();
                    return Err(Loss::Unsupported);
                }
                Ok(())
            }
            Ok(Err(error)) => {
                if again.is_some() && error.is_recoverable() {
                    self.flow.abandon();
                }
                Err(error.into())
            }
            Err(_) => Err(Loss::Stalled),
        }
    }
}

fn decimal(value: u64) -> String<20> {
    let mut text = String::new();
    // The largest value has 20 digits.
    let _ = write!(text, "{value}");
    text
}

fn text(text: &str) -> Result<MqttString<'_>, Loss> {
    MqttString::from_str(text).map_err(|_| Loss::Unsupported)
}
