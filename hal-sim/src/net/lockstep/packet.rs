//! As much of MQTT 5 as a robot speaks to its broker (OASIS MQTT Version 5.0, chapters 1 to 3).

use std::fmt;

/// Most bytes of a packet from a client, fixed header included.
pub(super) const MAX_PACKET: usize = 64 * 1024;

/// Why bytes from a client are refused. The connection is closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PacketError {
    /// The packet ends before its fields do, or a length in it does not add up.
    Malformed,
    /// Longer than 64 KiB.
    TooLarge,
    /// Reserved bits of the fixed header are wrong.
    Flags,
    /// A packet type that no client sends, or this broker does not know (QoS 2, AUTH).
    Unsupported(u8),
    /// Not MQTT 5.
    Version,
    /// A property that does not exist.
    Property(u8),
    /// A text that is not UTF-8.
    Text,
    /// A topic or filter that is empty or has a wildcard where none may be.
    Topic,
    /// Packet identifier 0.
    Identifier,
}

impl fmt::Display for PacketError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed => f.write_str("malformed packet"),
            Self::TooLarge => write!(f, "a packet above {MAX_PACKET} bytes"),
            Self::Flags => f.write_str("wrong flags in the fixed header"),
            Self::Unsupported(kind) => write!(f, "unsupported packet, first byte 0x{kind:02x}"),
            Self::Version => f.write_str("not MQTT 5"),
            Self::Property(id) => write!(f, "unknown property 0x{id:02x}"),
            Self::Text => f.write_str("a text is not UTF-8"),
            Self::Topic => f.write_str("not a valid topic"),
            Self::Identifier => f.write_str("packet identifier 0"),
        }
    }
}

impl std::error::Error for PacketError {}

/// A last will, or a message to publish.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Publication<'a> {
    pub(super) topic: &'a str,
    pub(super) payload: &'a [u8],
    pub(super) at_least_once: bool,
    pub(super) retain: bool,
}

#[derive(Debug, PartialEq, Eq)]
pub(super) struct Connect<'a> {
    pub(super) client: &'a str,
    pub(super) clean_start: bool,
    pub(super) keep_alive_s: u16,
    pub(super) session_expiry_s: u32,
    pub(super) receive_maximum: u16,
    pub(super) maximum_packet: u32,
    pub(super) will: Option<Publication<'a>>,
}

/// A packet from a client.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Packet<'a> {
    Connect(Connect<'a>),
    Publish {
        message: Publication<'a>,
        /// 0 at QoS 0.
        id: u16,
        duplicate: bool,
    },
    PubAck {
        id: u16,
    },
    Subscribe {
        id: u16,
        filters: Vec<(&'a str, u8)>,
    },
    Unsubscribe {
        id: u16,
        filters: Vec<&'a str>,
    },
    PingReq,
    Disconnect {
        reason: u8,
        session_expiry_s: Option<u32>,
    },
}

/// Length of the first packet in `bytes`, fixed header included; `None` while it is not known.
///
/// # Errors
/// When the length is not one, or above [`MAX_PACKET`].
pub(super) fn frame_len(bytes: &[u8]) -> Result<Option<usize>, PacketError> {
    let mut value = 0_usize;
    for place in 0..4 {
        let Some(&byte) = bytes.get(1 + place) else {
            return Ok(None);
        };
        value |= usize::from(byte & 0x7F) << (7 * place);
        if byte & 0x80 == 0 {
            let len = value + 2 + place;
            return if len > MAX_PACKET {
                Err(PacketError::TooLarge)
            } else {
                Ok(Some(len))
            };
        }
    }
    Err(PacketError::Malformed)
}

/// Reads one whole packet.
///
/// # Errors
/// See [`PacketError`].
pub(super) fn parse(frame: &[u8]) -> Result<Packet<'_>, PacketError> {
    let mut r = Reader(frame);
    let first = r.byte()?;
    r.varint()?;
    let flags = first & 0x0F;
    let packet = match first >> 4 {
        1 => {
            require(flags == 0)?;
            Packet::Connect(connect(&mut r)?)
        }
        3 => return publish(&mut r, first),
        4 => {
            require(flags == 0)?;
            let id = r.identifier()?;
            // Reason code and properties may be left out.
            if !r.0.is_empty() {
                r.byte()?;
                if !r.0.is_empty() {
                    r.properties()?;
                }
            }
            Packet::PubAck { id }
        }
        8 => {
            require(flags == 2)?;
            let id = r.identifier()?;
            r.properties()?;
            let mut filters = Vec::new();
            while !r.0.is_empty() {
                let filter = r.filter()?;
                let options = r.byte()?;
                if options & 0x03 == 3 || options & 0xC0 != 0 {
                    return Err(PacketError::Malformed);
                }
                filters.push((filter, options));
            }
            if filters.is_empty() {
                return Err(PacketError::Malformed);
            }
            Packet::Subscribe { id, filters }
        }
        10 => {
            require(flags == 2)?;
            let id = r.identifier()?;
            r.properties()?;
            let mut filters = Vec::new();
            while !r.0.is_empty() {
                filters.push(r.filter()?);
            }
            if filters.is_empty() {
                return Err(PacketError::Malformed);
            }
            Packet::Unsubscribe { id, filters }
        }
        12 => {
            require(flags == 0)?;
            Packet::PingReq
        }
        14 => {
            require(flags == 0)?;
            let reason = if r.0.is_empty() { 0 } else { r.byte()? };
            let properties = if r.0.is_empty() {
                Properties::default()
            } else {
                r.properties()?
            };
            Packet::Disconnect {
                reason,
                session_expiry_s: properties.session_expiry_s,
            }
        }
        _ => return Err(PacketError::Unsupported(first)),
    };
    if r.0.is_empty() {
        Ok(packet)
    } else {
        Err(PacketError::Malformed)
    }
}

fn require(right: bool) -> Result<(), PacketError> {
    if right {
        Ok(())
    } else {
        Err(PacketError::Flags)
    }
}

fn connect<'a>(r: &mut Reader<'a>) -> Result<Connect<'a>, PacketError> {
    if r.text()? != "MQTT" || r.byte()? != 5 {
        return Err(PacketError::Version);
    }
    let flags = r.byte()?;
    let keep_alive_s = r.word()?;
    let properties = r.properties()?;
    let client = r.text()?;
    if client.is_empty() {
        return Err(PacketError::Malformed);
    }
    let will_qos = flags >> 3 & 3;
    let will = if flags & 0x04 == 0 {
        require(flags & 0x38 == 0)?;
        None
    } else {
        r.properties()?;
        let topic = r.topic()?;
        let payload = r.binary()?;
        if will_qos > 1 {
            return Err(PacketError::Unsupported(0x10));
        }
        Some(Publication {
            topic,
            payload,
            at_least_once: will_qos == 1,
            retain: flags & 0x20 != 0,
        })
    };
    if flags & 0x80 != 0 {
        r.text()?;
    }
    if flags & 0x40 != 0 {
        r.binary()?;
    }
    require(flags & 0x01 == 0)?;
    if properties.receive_maximum == Some(0) || properties.maximum_packet == Some(0) {
        return Err(PacketError::Malformed);
    }
    Ok(Connect {
        client,
        clean_start: flags & 0x02 != 0,
        keep_alive_s,
        session_expiry_s: properties.session_expiry_s.unwrap_or(0),
        receive_maximum: properties.receive_maximum.unwrap_or(u16::MAX),
        maximum_packet: properties.maximum_packet.unwrap_or(u32::MAX),
        will,
    })
}

fn publish<'a>(r: &mut Reader<'a>, first: u8) -> Result<Packet<'a>, PacketError> {
    let qos = first >> 1 & 3;
    if qos > 1 {
        return Err(PacketError::Unsupported(first));
    }
    let duplicate = first & 0x08 != 0;
    require(qos == 1 || !duplicate)?;
    let topic = r.topic()?;
    let id = if qos == 1 { r.identifier()? } else { 0 };
    r.properties()?;
    let payload = std::mem::take(&mut r.0);
    Ok(Packet::Publish {
        message: Publication {
            topic,
            payload,
            at_least_once: qos == 1,
            retain: first & 0x01 != 0,
        },
        id,
        duplicate,
    })
}

#[derive(Default)]
struct Properties {
    session_expiry_s: Option<u32>,
    receive_maximum: Option<u16>,
    maximum_packet: Option<u32>,
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, len: usize) -> Result<&'a [u8], PacketError> {
        let (head, tail) = self.0.split_at_checked(len).ok_or(PacketError::Malformed)?;
        self.0 = tail;
        Ok(head)
    }

    fn byte(&mut self) -> Result<u8, PacketError> {
        Ok(self.take(1)?[0])
    }

    fn word(&mut self) -> Result<u16, PacketError> {
        let bytes = self.take(2)?;
        Ok(u16::from_be_bytes([bytes[0], bytes[1]]))
    }

    fn long(&mut self) -> Result<u32, PacketError> {
        let bytes = self.take(4)?;
        Ok(u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    fn varint(&mut self) -> Result<usize, PacketError> {
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

    fn binary(&mut self) -> Result<&'a [u8], PacketError> {
        let len = self.word()?;
        self.take(usize::from(len))
    }

    fn text(&mut self) -> Result<&'a str, PacketError> {
        std::str::from_utf8(self.binary()?).map_err(|_| PacketError::Text)
    }

    fn topic(&mut self) -> Result<&'a str, PacketError> {
        let topic = self.text()?;
        if topic.is_empty() || topic.contains(['+', '#', '\0']) {
            return Err(PacketError::Topic);
        }
        Ok(topic)
    }

    /// A filter: `+` and `#` fill whole levels, `#` only the last.
    fn filter(&mut self) -> Result<&'a str, PacketError> {
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

    fn identifier(&mut self) -> Result<u16, PacketError> {
        match self.word()? {
            0 => Err(PacketError::Identifier),
            id => Ok(id),
        }
    }

    /// Section 2.2.2.2 of the standard: identifiers and types of all properties.
    fn properties(&mut self) -> Result<Properties, PacketError> {
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

/// Whether `filter` selects `topic` (section 4.7 of the standard).
pub(super) fn matches(filter: &str, topic: &str) -> bool {
    let mut topic_levels = topic.split('/');
    for level in filter.split('/') {
        if level == "#" {
            return true;
        }
        match topic_levels.next() {
            Some(name) if level == "+" || level == name => {}
            _ => return false,
        }
    }
    topic_levels.next().is_none()
}

pub(super) fn write_conn_ack(out: &mut Vec<u8>, session_present: bool, reason: u8) {
    // Without properties: no limit below the standard's own defaults.
    out.extend_from_slice(&[0x20, 3, u8::from(session_present), reason, 0]);
}

pub(super) fn write_ping_resp(out: &mut Vec<u8>) {
    out.extend_from_slice(&[0xD0, 0]);
}

pub(super) fn write_pub_ack(out: &mut Vec<u8>, id: u16) {
    let [high, low] = id.to_be_bytes();
    out.extend_from_slice(&[0x40, 2, high, low]);
}

/// SUBACK and UNSUBACK.
pub(super) fn write_sub_ack(out: &mut Vec<u8>, first: u8, id: u16, codes: &[u8]) {
    out.push(first);
    write_varint(out, 3 + codes.len());
    out.extend_from_slice(&id.to_be_bytes());
    out.push(0);
    out.extend_from_slice(codes);
}

pub(super) fn write_disconnect(out: &mut Vec<u8>, reason: u8) {
    out.extend_from_slice(&[0xE0, 2, reason, 0]);
}

/// Length of a PUBLISH as [`write_publish`] writes it.
pub(super) fn publish_len(message: &Publication<'_>) -> usize {
    let rest = publish_rest(message);
    let digits = match rest {
        0..128 => 1,
        128..16_384 => 2,
        16_384..2_097_152 => 3,
        _ => 4,
    };
    1 + digits + rest
}

fn publish_rest(message: &Publication<'_>) -> usize {
    2 + message.topic.len() + 2 * usize::from(message.at_least_once) + 1 + message.payload.len()
}

/// Writes a PUBLISH; `id` counts at QoS 1 only.
pub(super) fn write_publish(
    out: &mut Vec<u8>,
    message: &Publication<'_>,
    id: u16,
    duplicate: bool,
) {
    let qos = u8::from(message.at_least_once);
    out.push(0x30 | u8::from(duplicate) << 3 | qos << 1 | u8::from(message.retain));
    write_varint(out, publish_rest(message));
    out.extend_from_slice(&(message.topic.len() as u16).to_be_bytes());
    out.extend_from_slice(message.topic.as_bytes());
    if message.at_least_once {
        out.extend_from_slice(&id.to_be_bytes());
    }
    out.push(0);
    out.extend_from_slice(message.payload);
}

fn write_varint(out: &mut Vec<u8>, mut value: usize) {
    loop {
        let byte = (value & 0x7F) as u8;
        value >>= 7;
        if value == 0 {
            out.push(byte);
            return;
        }
        out.push(byte | 0x80);
    }
}

#[cfg(test)]
#[path = "packet_tests.rs"]
mod tests;
