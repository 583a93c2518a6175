//! As much of MQTT 5 as a robot speaks to its broker (OASIS MQTT Version 5.0, chapters 1 to 3).

mod parse;
mod reader;
#[cfg(test)]
mod tests;
mod write;

use std::fmt;

pub(super) use parse::parse;
pub(super) use write::{
    publish_len, write_conn_ack, write_disconnect, write_ping_resp, write_pub_ack, write_publish,
    write_sub_ack,
};

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
    pub(super) username: Option<&'a str>,
    pub(super) password: Option<&'a [u8]>,
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
