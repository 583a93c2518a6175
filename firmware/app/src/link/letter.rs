//! Where the MQTT client puts what it receives.
//!
//! The client asks a buffer provider for memory that lives as long as itself, so memory it once
//! got can be used again only by going behind the borrow checker's back. This program does not
//! do that. Its provider hands out one buffer per field of a packet, keeps the bytes to itself,
//! and gives the client a row of dashes of the same length instead. The client needs no more: it
//! counts lengths, and a row of dashes passes for a topic or a text. The link reads topic and
//! payload of a message here.

use core::cell::{RefCell, RefMut};

use rust_mqtt::Bytes;
use rust_mqtt::buffer::BufferProvider;

/// Largest packet the broker may send: a message of the contract (1,024 bytes), its topic and
/// properties, and enough beyond it that a message somewhat too long is refused by name rather
/// than by the broker.
pub(super) const MAX_PACKET: usize = 1_280;

/// Longest topic that is kept; every topic of a fleet is shorter.
const MAX_TOPIC: usize = 96;

const DASHES: &[u8; MAX_PACKET] = &[b'-'; MAX_PACKET];

/// The packet being received.
#[derive(Debug)]
pub(super) struct Letter {
    fields: u8,
    topic: [u8; MAX_TOPIC],
    topic_len: usize,
    last: [u8; MAX_PACKET],
    last_len: usize,
}

impl Letter {
    pub(super) const fn new() -> Self {
        Self {
            fields: 0,
            topic: [0; MAX_TOPIC],
            topic_len: 0,
            last: [0; MAX_PACKET],
            last_len: 0,
        }
    }

    /// Makes ready for the next packet.
    pub(super) fn clear(&mut self) {
        self.fields = 0;
        self.topic_len = 0;
        self.last_len = 0;
    }

    /// Topic of a PUBLISH packet: its first field. Empty when it is longer than any of ours.
    pub(super) fn topic(&self) -> &[u8] {
        &self.topic[..self.topic_len]
    }

    /// Payload of a PUBLISH packet: its last field.
    pub(super) fn payload(&self) -> &[u8] {
        &self.last[..self.last_len]
    }

    fn keep(&mut self, len: usize) {
        if self.fields == 0 && len <= MAX_TOPIC {
            self.topic[..len].copy_from_slice(&self.last[..len]);
            self.topic_len = len;
        }
        self.fields = self.fields.saturating_add(1);
        self.last_len = len;
    }
}

/// The packet does not fit, or two of its fields are wanted at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NoSpace;

/// Hands the buffer of a [`Letter`] to the client, field by field.
#[derive(Debug)]
pub(super) struct Mailbox<'a>(pub(super) &'a RefCell<Letter>);

/// One field, while it is being received.
#[derive(Debug)]
pub(super) struct Field<'a> {
    letter: RefMut<'a, Letter>,
    len: usize,
}

impl AsMut<[u8]> for Field<'_> {
    fn as_mut(&mut self) -> &mut [u8] {
        &mut self.letter.last[..self.len]
    }
}

impl<'a> From<Field<'a>> for Bytes<'a> {
    fn from(mut field: Field<'a>) -> Self {
        let len = field.len;
        field.letter.keep(len);
        Bytes::Borrowed(&DASHES[..len])
    }
}

impl<'a> BufferProvider<'a> for Mailbox<'a> {
    type Buffer = Field<'a>;
    type ProvisionError = NoSpace;

    fn provide_buffer(&mut self, len: usize) -> Result<Field<'a>, NoSpace> {
        if len > MAX_PACKET {
            return Err(NoSpace);
        }
        let letter = self.0.try_borrow_mut().map_err(|_| NoSpace)?;
        Ok(Field { letter, len })
    }
}
