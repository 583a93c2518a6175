//! Images on their way to the broker.
//!
//! The link takes an image out of its slot and keeps it, through any number of connections, until
//! the broker has acknowledged or refused it. While its bytes are written nothing else travels,
//! not even a command to this robot: at most [`WRITTEN_WITHIN`](super::WRITTEN_WITHIN).

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

use super::flow::{InFlight, MessageKind};
use super::loss::Loss;
use super::outgoing::publication;
use super::session::Connection;
use crate::camera::{Image, ImageSlot, Outcome};
use crate::hold::Hold;

/// Where the link gets images from. A trait object, so that only one link is compiled.
pub(super) trait Images {
    /// Whether there is an image to deliver.
    fn waits(&mut self) -> bool;
    /// The image to deliver: bytes, number, time.
    fn image(&self) -> Option<(&[u8], u32, u64)>;
    /// Lets go of the image.
    fn settle(&mut self, outcome: Outcome);
}

/// The images of a body without a camera.
pub(super) struct NoImages;

impl Images for NoImages {
    fn waits(&mut self) -> bool {
        false
    }

    fn image(&self) -> Option<(&[u8], u32, u64)> {
        None
    }

    fn settle(&mut self, _: Outcome) {}
}

/// The images of a camera.
pub(super) struct FromSlot<'a, M: RawMutex, B> {
    slot: &'a ImageSlot<M, B>,
    held: Option<Image<B>>,
}

impl<'a, M: RawMutex, B> FromSlot<'a, M, B> {
    pub(super) const fn new(slot: &'a ImageSlot<M, B>) -> Self {
        Self { slot, held: None }
    }
}

impl<M: RawMutex, B: AsRef<[u8]>> Images for FromSlot<'_, M, B> {
    fn waits(&mut self) -> bool {
        if self.held.is_none() {
            self.held = self.slot.collect();
        }
        self.held.is_some()
    }

    fn image(&self) -> Option<(&[u8], u32, u64)> {
        let image = self.held.as_ref()?;
        Some((image.jpeg(), image.frame(), image.timestamp()))
    }

    fn settle(&mut self, outcome: Outcome) {
        if let Some(image) = self.held.take() {
            self.slot.settle(image.into_buffer(), outcome);
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
