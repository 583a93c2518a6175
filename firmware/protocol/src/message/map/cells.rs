//! Bytes as base64 (RFC 4648, section 4), in whole groups: three bytes are four characters, and none is left over.

use core::fmt;

use heapless::{String, Vec};
use serde::de::{self, Deserializer, Unexpected, Visitor};
use serde::ser::{Error as _, Serializer};

use super::MAX_MAP_BYTES;

const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Most characters of it.
const MAX_TEXT: usize = MAX_MAP_BYTES / 3 * 4;

pub(super) fn serialize<S: Serializer>(
    cells: &Vec<u8, MAX_MAP_BYTES>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let text = encode(cells).ok_or_else(|| S::Error::custom("not whole groups of three bytes"))?;
    serializer.serialize_str(&text)
}

fn encode(bytes: &[u8]) -> Option<String<MAX_TEXT>> {
    let mut text = String::new();
    let groups = bytes.chunks_exact(3);
    if !groups.remainder().is_empty() {
        return None;
    }
    for group in groups {
        let bits = group
            .iter()
            .fold(0, |bits, byte| bits << 8 | u32::from(*byte));
        for shift in [18, 12, 6, 0] {
            let character = ALPHABET[(bits >> shift & 63) as usize];
            text.push(char::from(character)).ok()?;
        }
    }
    Some(text)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Vec<u8, MAX_MAP_BYTES>, D::Error> {
    struct Text;

    impl Visitor<'_> for Text {
        type Value = Vec<u8, MAX_MAP_BYTES>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "at most {MAX_MAP_BYTES} bytes in base64")
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<Self::Value, E> {
            decode(text.as_bytes()).ok_or_else(|| E::invalid_value(Unexpected::Str(text), &self))
        }
    }

    deserializer.deserialize_str(Text)
}

fn decode(text: &[u8]) -> Option<Vec<u8, MAX_MAP_BYTES>> {
    let mut bytes = Vec::new();
    let groups = text.chunks_exact(4);
    if text.is_empty() || !groups.remainder().is_empty() {
        return None;
    }
    for group in groups {
        let mut bits = 0;
        for character in group {
            bits = bits << 6 | value(*character)?;
        }
        let [_, decoded @ ..] = bits.to_be_bytes();
        bytes.extend_from_slice(&decoded).ok()?;
    }
    Some(bytes)
}

fn value(character: u8) -> Option<u32> {
    let (first, offset) = match character {
        b'A'..=b'Z' => (b'A', 0),
        b'a'..=b'z' => (b'a', 26),
        b'0'..=b'9' => (b'0', 52),
        b'+' => return Some(62),
        b'/' => return Some(63),
        _ => return None,
    };
    Some(u32::from(character - first) + offset)
}
