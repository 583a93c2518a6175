//! Fields of packets (OASIS MQTT Version 5.0, section 1.5).

use super::PacketError;

/// Properties that mean something to the broker.
#[derive(Default)]
pub(super) struct Properties {
    pub(super) session_expiry_s: Option<u32>,
    pub(super) receive_maximum: Option<u16>,
    pub(super) maximum_packet: Option<u32>,
}

/// The bytes of a packet that are not read yet.
pub(super) struct Reader<'a>(pub(super) &'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, len: usize) -> Result<&'a [u8], PacketError> {
        let (head, tail) = self.0.split_at_checked(len).ok_or(PacketError::Malformed)?;
        self.0 = tail;
        Ok(head)
    }

    pub(super) fn byte(&mut self) -> Result<u8, PacketError> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn word(&mut self) -> Result<u16, PacketError> {
        let bytes = self.take(2)?;
        Ok(u16::from_be_bytes([bytes[0], bytes[1]]))
    }

    fn long(&mut self) -> Result<u32, PacketError> {
        let bytes = self.take(4)?;
        Ok(u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    pub(super) fn varint(&mut self) -> Result<usize, PacketError> {
        let mut value = 0;
        for place in 0..4 {
            let byte = self.byte()?;
            value |= usize::from(byte & 0x7F) << (7 * place);
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(PacketError::Malformed)
    }

    pub(super) fn binary(&mut self) -> Result<&'a [u8], PacketError> {
        let len = self.word()?;
        self.take(usize::from(len))
    }

    pub(super) fn text(&mut self) -> Result<&'a str, PacketError> {
        std::str::from_utf8(self.binary()?).map_err(|_| PacketError::Text)
    }

    pub(super) fn topic(&mut self) -> Result<&'a str, PacketError> {
        let topic = self.text()?;
        if topic.is_empty() || topic.contains(['+', '#', '\0']) {
            return Err(PacketError::Topic);
        }
        Ok(topic)
    }

    /// A filter: `+` and `#` fill whole levels, `#` only the last.
    pub(super) fn filter(&mut self) -> Result<&'a str, PacketError> {
        let filter = self.text()?;
        let mut levels = filter.split('/').peekable();
        let mut sound = !filter.is_empty() && !filter.contains('\0');
        while let Some(level) = levels.next() {
            let wild = level.contains(['+', '#']);
            sound &= !wild || level == "+" || (level == "#" && levels.peek().is_none());
        }
        if sound {
            Ok(filter)
        } else {
            Err(PacketError::Topic)
        }
    }

    pub(super) fn identifier(&mut self) -> Result<u16, PacketError> {
        match self.word()? {
            0 => Err(PacketError::Identifier),
            id => Ok(id),
        }
    }

    /// Section 2.2.2.2 of the standard: identifiers and types of all properties.
    pub(super) fn properties(&mut self) -> Result<Properties, PacketError> {
        let len = self.varint()?;
        let mut r = Reader(self.take(len)?);
        let mut found = Properties::default();
        while !r.0.is_empty() {
            match r.byte()? {
                0x01 | 0x17 | 0x19 | 0x24 | 0x25 | 0x28 | 0x29 | 0x2A => {
                    r.byte()?;
                }
                0x13 | 0x22 | 0x23 => {
                    r.word()?;
                }
                0x02 | 0x18 => {
                    r.long()?;
                }
                0x03 | 0x08 | 0x12 | 0x15 | 0x1A | 0x1C | 0x1F => {
                    r.text()?;
                }
                0x09 | 0x16 => {
                    r.binary()?;
                }
                0x0B => {
                    r.varint()?;
                }
                0x26 => {
                    r.text()?;
                    r.text()?;
                }
                0x11 => found.session_expiry_s = Some(r.long()?),
                0x21 => found.receive_maximum = Some(r.word()?),
                0x27 => found.maximum_packet = Some(r.long()?),
                other => return Err(PacketError::Property(other)),
            }
        }
        Ok(found)
    }
}
