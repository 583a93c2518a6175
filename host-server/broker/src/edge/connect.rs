//! The first packet of a client: a CONNECT, whole, in time and of a version that the broker speaks.

use std::ops::Range;

use tokio::io::{AsyncRead, AsyncReadExt as _};
use tokio::time::{Instant, timeout_at};

use super::Times;
use super::packets::Properties;
use crate::accounts::Refusal;

/// Largest CONNECT: room for one field of any length (65,535 bytes), and for all else that there is.
const LARGEST: usize = 72 * 1024;
/// CONNECT, with the reserved flags zero (MQTT 5, section 2.1).
const CONNECT: u8 = 0x10;
/// The levels of MQTT 3.1, 3.1.1 and 5.
pub(super) const LEVEL_3_1: u8 = 3;
pub(super) const LEVEL_3_1_1: u8 = 4;
pub(super) const LEVEL_5: u8 = 5;

/// A CONNECT that the broker may have.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Connect {
    pub(super) level: u8,
    pub(super) bytes: Vec<u8>,
}

/// Why there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum NoConnect {
    /// The client went away, with or without having said anything.
    Gone,
    /// It is refused.
    Refused {
        /// Why.
        reason: Refusal,
        /// What tells the client, where there is something.
        answer: &'static [u8],
    },
}

impl NoConnect {
    const fn refused(reason: Refusal) -> Self {
        let answer = &[];
        Self::Refused { reason, answer }
    }
}

/// CONNACK with *unsupported protocol version*, as a client of MQTT 3.1.1 reads it (section 3.2.2.3) and
/// every client before it.
const UNSUPPORTED_3: &[u8] = &[0x20, 2, 0, 1];
/// The same for a client of MQTT 5 or of what comes after it (section 3.2.2.2).
const UNSUPPORTED_5: &[u8] = &[0x20, 3, 0, 0x84, 0];
const TOO_LARGE_5: &[u8] = &[0x20, 3, 0, 0x95, 0];

/// CONNACK with *server unavailable*, and for MQTT 5 *server busy*.
pub(super) const fn busy(level: u8) -> &'static [u8] {
    if level == LEVEL_5 {
        &[0x20, 3, 0, 0x89, 0]
    } else {
        &[0x20, 2, 0, 3]
    }
}

/// Reads the CONNECT of a client.
///
/// # Errors
/// [`NoConnect`] says why it is not let in.
///
/// # Cancellation Safety
/// What was read is lost.
pub(super) async fn read(
    client: &mut (impl AsyncRead + Unpin),
    times: Times,
) -> Result<Connect, NoConnect> {
    let begun = Instant::now();
    let whole = begun + times.connect;
    let mut bytes = Vec::new();
    more(client, &mut bytes, 1, whole.min(begun + times.first_byte)).await?;
    let (level, length) = loop {
        match outline(&bytes)? {
            Outline::Missing(missing) => more(client, &mut bytes, missing, whole).await?,
            Outline::Known { level, length } => break (level, length),
        }
    };
    while bytes.len() < length {
        let missing = length - bytes.len();
        more(client, &mut bytes, missing, whole).await?;
    }
    if level == LEVEL_5 {
        mend_will(&mut bytes);
    }
    Ok(Connect { level, bytes })
}

/// Reads at most `most` bytes, and at least one.
async fn more(
    client: &mut (impl AsyncRead + Unpin),
    bytes: &mut Vec<u8>,
    most: usize,
    end: Instant,
) -> Result<(), NoConnect> {
    let mut chunk = [0; 1_024];
    let most = most.min(chunk.len());
    let chunk = chunk.get_mut(..most).unwrap_or_default();
    match timeout_at(end, client.read(chunk)).await {
        Err(_) => Err(NoConnect::refused(Refusal::Silent)),
        Ok(Ok(0) | Err(_)) => Err(NoConnect::Gone),
        Ok(Ok(length)) => {
            bytes.extend_from_slice(chunk.get(..length).unwrap_or_default());
            Ok(())
        }
    }
}

/// What the beginning of a packet tells.
#[derive(Debug, PartialEq, Eq)]
enum Outline {
    /// At least so many bytes are missing to know.
    Missing(usize),
    /// A CONNECT.
    Known {
        level: u8,
        /// Of the whole packet.
        length: usize,
    },
}

fn outline(bytes: &[u8]) -> Result<Outline, NoConnect> {
    let malformed = NoConnect::refused(Refusal::Malformed);
    match bytes.first() {
        None => return Ok(Outline::Missing(1)),
        Some(&CONNECT) => {}
        Some(_) => return Err(malformed),
    }
    let Some((remaining, at)) = variable(bytes, 1)? else {
        return Ok(Outline::Missing(1));
    };
    let length = at + remaining;
    let Some(name) = bytes.get(at..at + 2) else {
        return Ok(Outline::Missing(at + 2 - bytes.len()));
    };
    let name = match name {
        [0, 4] => &b"MQTT"[..],
        [0, 6] => b"MQIsdp",
        _ => return Err(malformed),
    };
    let at = at + 2;
    let known = bytes.get(at..).unwrap_or_default();
    let known = known.get(..name.len()).unwrap_or(known);
    if !name.starts_with(known) || at + name.len() >= length {
        return Err(malformed);
    }
    let Some(level) = bytes.get(at + name.len()).copied() else {
        return Ok(Outline::Missing(at + name.len() + 1 - bytes.len()));
    };
    let answer = match (name.len(), level) {
        (6, LEVEL_3_1) | (4, LEVEL_3_1_1 | LEVEL_5) if length <= LARGEST => {
            return Ok(Outline::Known { level, length });
        }
        (6, LEVEL_3_1) | (4, LEVEL_3_1_1) => return Err(malformed),
        (4, LEVEL_5) => {
            return Err(NoConnect::Refused {
                reason: Refusal::Malformed,
                answer: TOO_LARGE_5,
            });
        }
        (_, level) if level > LEVEL_5 => UNSUPPORTED_5,
        _ => UNSUPPORTED_3,
    };
    Err(NoConnect::Refused {
        reason: Refusal::Version,
        answer,
    })
}

/// The variable byte integer at `at`, and where it ends (MQTT 5, section 1.5.5); `None` when a part of it is
/// missing.
fn variable(bytes: &[u8], at: usize) -> Result<Option<(usize, usize)>, NoConnect> {
    let mut value = 0;
    for place in 0..4 {
        let Some(byte) = bytes.get(at + place).copied() else {
            return Ok(None);
        };
        value |= usize::from(byte & 0x7f) << (7 * place);
        if byte < 0x80 {
            return Ok(Some((value, at + place + 1)));
        }
    }
    Err(NoConnect::refused(Refusal::Malformed))
}

/// The properties of a will are held to the same as those of a publish. What is malformed is left to the
/// broker.
fn mend_will(bytes: &mut [u8]) {
    let Some(will) = will_properties(bytes) else {
        return;
    };
    let mut properties = Properties::new(will.len() as u32);
    for byte in bytes.get_mut(will).unwrap_or_default() {
        // A will has no topic alias; the broker refuses one that does.
        if properties.pass(byte).is_err() {
            return;
        }
    }
}

/// Where the properties of the will stand in a CONNECT of MQTT 5 (section 3.1).
fn will_properties(bytes: &[u8]) -> Option<Range<usize>> {
    const WILL: u8 = 0x04;
    let (_, name) = variable(bytes, 1).ok()??;
    // Behind the name and the level; the keep alive follows.
    let flags = name + 2 + 4 + 1;
    if bytes.get(flags)? & WILL == 0 {
        return None;
    }
    let (length, own) = variable(bytes, flags + 3).ok()??;
    let client_id = own + length;
    let [high, low] = bytes.get(client_id..client_id + 2)? else {
        return None;
    };
    let behind = client_id + 2 + usize::from(u16::from_be_bytes([*high, *low]));
    let (length, begin) = variable(bytes, behind).ok()??;
    let range = begin..begin + length;
    bytes.get(range.clone()).map(|_| range)
}

#[cfg(test)]
#[path = "connect_tests.rs"]
mod tests;
