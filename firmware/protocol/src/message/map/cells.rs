//! Bytes as base64 (RFC 4648, section 4), in whole groups: three bytes are four characters, and none is left over.

use core::fmt;

use base64ct::{Base64Unpadded, Encoding as _};
use heapless::Vec;
use serde::de::{self, Deserializer, Unexpected, Visitor};
use serde::ser::{Error as _, Serializer};

use super::MAX_MAP_BYTES;

/// Most characters of it.
const MAX_TEXT: usize = MAX_MAP_BYTES / 3 * 4;

pub(super) fn serialize<S: Serializer>(
    cells: &Vec<u8, MAX_MAP_BYTES>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut text = [0; MAX_TEXT];
    if !cells.len().is_multiple_of(3) {
        return Err(S::Error::custom("not whole groups of three bytes"));
    }
    let text = Base64Unpadded::encode(cells, &mut text).map_err(S::Error::custom)?;
    serializer.serialize_str(text)
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
            decode(text).ok_or_else(|| E::invalid_value(Unexpected::Str(text), &self))
        }
    }

    deserializer.deserialize_str(Text)
}

fn decode(text: &str) -> Option<Vec<u8, MAX_MAP_BYTES>> {
    if text.is_empty() || !text.len().is_multiple_of(4) {
        return None;
    }
    let mut bytes = Vec::new();
    bytes.resize_default(text.len() / 4 * 3).ok()?;
    Base64Unpadded::decode(text, &mut bytes).ok()?;
    Some(bytes)
}
