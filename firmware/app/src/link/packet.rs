//! Where the MQTT client puts what it receives.
//!
//! The client asks a buffer provider for memory that lives as long as itself, so memory it once
//! got can be used again only by going behind the borrow checker's back. This program does not
//! do that. Its provider hands out one buffer per field of a packet, keeps the bytes to itself,
//! and gives the client a row of dashes of the same length instead. The client needs no more: it
//! counts lengths, and a row of dashes passes for a topic or a text. The link reads topic and
//! payload of a message here.

use core::cell::{RefCell, RefMut};

use crawler_protocol::MAX_MESSAGE;
use rust_mqtt::Bytes;
use rust_mqtt::buffer::BufferProvider;

use crate::hold::{Blank, Hold, Room};

/// Largest packet the broker may send: a message of the contract (1,024 bytes), its topic and
/// properties, and enough beyond it that a message somewhat too long is refused by name rather
/// than by the broker.
pub(super) const MAX_PACKET: usize = 1_280;

/// Longest topic that is kept; every topic of a fleet is shorter.
const MAX_TOPIC: usize = 96;

const DASHES: &[u8; MAX_PACKET] = &[b'-'; MAX_PACKET];

/// What a packet is written on.
#[derive(Debug)]
pub(super) struct Sheet {
    topic: [u8; MAX_TOPIC],
    last: [u8; MAX_PACKET],
}

impl Blank for Sheet {
    const BLANK: Self = Self {
        topic: [0; MAX_TOPIC],
        last: [0; MAX_PACKET],
    };
}

/// The packet being received.
pub(super) struct PacketBuffer<H: Hold> {
    sheet: H::Room<Sheet>,
    fields: u8,
    topic_len: usize,
    last_len: usize,
}

impl<H: Hold> PacketBuffer<H> {
    pub(super) const fn new() -> Self {
        Self {
            sheet: Room::EMPTY,
            fields: 0,
            topic_len: 0,
            last_len: 0,
        }
    }

    /// Throws it away: nothing in it is wanted any more.
    pub(super) fn discard(&mut self) {
        self.clear();
        self.sheet.leave();
    }

    /// Makes ready for the next packet.
    pub(super) fn clear(&mut self) {
        self.fields = 0;
        self.topic_len = 0;
        self.last_len = 0;
    }

    /// Topic of a PUBLISH packet: its first field. Empty when it is longer than any of ours.
    pub(super) fn topic(&self) -> &[u8] {
        let sheet = self.sheet.get();
        sheet.map_or(&[], |sheet| &sheet.topic[..self.topic_len])
    }

    /// Payload of a PUBLISH packet: its last field.
    pub(super) fn payload(&self) -> &[u8] {
        self.draft(self.last_len)
    }

    /// Where the next message is written before it is sent. Nothing is received meanwhile, so
    /// it is the same memory.
    pub(super) fn page(&mut self) -> &mut [u8] {
        self.clear();
        &mut self.sheet.enter().last[..MAX_MESSAGE]
    }

    /// The first `len` bytes of the message on the page.
    pub(super) fn draft(&self, len: usize) -> &[u8] {
        self.sheet.get().map_or(&[], |sheet| &sheet.last[..len])
    }

    fn keep(&mut self, len: usize) {
        if self.fields == 0 && len <= MAX_TOPIC {
            let Sheet { topic, last } = self.sheet.enter();
            topic[..len].copy_from_slice(&last[..len]);
            self.topic_len = len;
        }
        self.fields = self.fields.saturating_add(1);
        self.last_len = len;
    }
}

/// The packet does not fit, or two of its fields are wanted at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NoSpace;

/// Hands the buffer of a [`PacketBuffer`] to the client, field by field.
pub(super) struct BufferLender<'a, H: Hold>(pub(super) &'a RefCell<PacketBuffer<H>>);

/// One field, while it is being received.
pub(super) struct Field<'a, H: Hold> {
    packet: RefMut<'a, PacketBuffer<H>>,
    len: usize,
}

impl<H: Hold> AsMut<[u8]> for Field<'_, H> {
    fn as_mut(&mut self) -> &mut [u8] {
        &mut self.packet.sheet.enter().last[..self.len]
    }
}

impl<'a, H: Hold> From<Field<'a, H>> for Bytes<'a> {
    fn from(mut field: Field<'a, H>) -> Self {
        let len = field.len;
        field.packet.keep(len);
        Bytes::Borrowed(&DASHES[..len])
    }
}

impl<'a, H: Hold> BufferProvider<'a> for BufferLender<'a, H> {
    type Buffer = Field<'a, H>;
    type ProvisionError = NoSpace;

    fn provide_buffer(&mut self, len: usize) -> Result<Field<'a, H>, NoSpace> {
        if len > MAX_PACKET {
            return Err(NoSpace);
        }
        let packet = self.0.try_borrow_mut().map_err(|_| NoSpace)?;
        Ok(Field { packet, len })
    }
}
