//! What a server has heard, for the others: messages as they came, many in a frame.
//!
//! ```text
//! frame    version (1), length of the sender (1), sender, messages…
//! message  flags (1), topic, payload, content type if a flag says so, number of properties (1),
//!          (name, value)…
//! topic, content type, name, value: length (2), bytes;  payload: length (4), bytes;  big endian
//! ```
//! A frame comes from the network like everything else: nothing in it is taken for granted but its
//! own lengths.

use std::fmt;

const VERSION: u8 = 1;
const RETAINED: u8 = 1;
const TYPED: u8 = 2;

/// One message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Where it was published.
    pub topic: Vec<u8>,
    /// What it says.
    pub payload: Vec<u8>,
    /// Whether the broker had kept it.
    pub retained: bool,
    /// What the payload is.
    pub content_type: Option<String>,
    /// User properties.
    pub properties: Vec<(String, String)>,
}

/// A message to be written: as [`Message`].
#[derive(Debug, Clone, Copy)]
pub struct OutgoingMessage<'a> {
    /// Where it was published.
    pub topic: &'a [u8],
    /// What it says.
    pub payload: &'a [u8],
    /// Whether the broker had kept it.
    pub retained: bool,
    /// What the payload is.
    pub content_type: Option<&'a str>,
    /// User properties.
    pub properties: &'a [(String, String)],
}

/// The bytes are no frame of this version.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoFrame;

impl fmt::Display for NoFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a frame that this version knows")
    }
}

impl std::error::Error for NoFrame {}

/// The beginning of a frame of `sender`, of whom 255 bytes count.
#[must_use]
pub fn begin(sender: &str) -> Vec<u8> {
    let sender = &sender.as_bytes()[..sender.len().min(255)];
    let mut frame = vec![VERSION, sender.len() as u8];
    frame.extend_from_slice(sender);
    frame
}

/// Writes one message. False when it has parts that a frame has no room for; nothing is written
/// then.
pub fn put(frame: &mut Vec<u8>, message: OutgoingMessage<'_>) -> bool {
    let OutgoingMessage {
        topic,
        payload,
        retained,
        content_type,
        properties,
    } = message;
    let before = frame.len();
    let retained = if retained { RETAINED } else { 0 };
    let typed = if content_type.is_some() { TYPED } else { 0 };
    frame.push(retained | typed);
    let written = short(frame, topic)
        && u32::try_from(payload.len()).is_ok_and(|length| {
            frame.extend_from_slice(&length.to_be_bytes());
            frame.extend_from_slice(payload);
            true
        })
        && content_type.is_none_or(|text| short(frame, text.as_bytes()))
        && u8::try_from(properties.len()).is_ok_and(|count| {
            frame.push(count);
            properties.iter().all(|(name, value)| {
                short(frame, name.as_bytes()) && short(frame, value.as_bytes())
            })
        });
    if !written {
        frame.truncate(before);
    }
    written
}

fn short(frame: &mut Vec<u8>, bytes: &[u8]) -> bool {
    u16::try_from(bytes.len()).is_ok_and(|length| {
        frame.extend_from_slice(&length.to_be_bytes());
        frame.extend_from_slice(bytes);
        true
    })
}

/// Reads who sent a frame, and its messages.
///
/// # Errors
/// [`NoFrame`].
pub fn read(frame: &[u8]) -> Result<(&str, Vec<Message>), NoFrame> {
    let mut rest = frame;
    let [version, length] = take(&mut rest)?;
    if version != VERSION {
        return Err(NoFrame);
    }
    let sender = std::str::from_utf8(bytes(&mut rest, length.into())?).map_err(|_| NoFrame)?;
    let mut messages = Vec::new();
    while !rest.is_empty() {
        let [flags] = take(&mut rest)?;
        if flags & !(RETAINED | TYPED) != 0 {
            return Err(NoFrame);
        }
        let topic = short_of(&mut rest)?.to_vec();
        let length = u32::from_be_bytes(take(&mut rest)?);
        let length = usize::try_from(length).map_err(|_| NoFrame)?;
        let payload = bytes(&mut rest, length)?.to_vec();
        let typed = flags & TYPED != 0;
        let content_type = typed.then(|| text(&mut rest)).transpose()?;
        let [count] = take(&mut rest)?;
        let mut properties = Vec::new();
        for _ in 0..count {
            properties.push((text(&mut rest)?, text(&mut rest)?));
        }
        messages.push(Message {
            topic,
            payload,
            retained: flags & RETAINED != 0,
            content_type,
            properties,
        });
    }
    Ok((sender, messages))
}

fn take<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], NoFrame> {
    let (first, after) = rest.split_first_chunk::<N>().ok_or(NoFrame)?;
    *rest = after;
    Ok(*first)
}

fn bytes<'a>(rest: &mut &'a [u8], length: usize) -> Result<&'a [u8], NoFrame> {
    let (first, after) = rest.split_at_checked(length).ok_or(NoFrame)?;
    *rest = after;
    Ok(first)
}

fn short_of<'a>(rest: &mut &'a [u8]) -> Result<&'a [u8], NoFrame> {
    let length = u16::from_be_bytes(take(rest)?);
    bytes(rest, length.into())
}

fn text(rest: &mut &[u8]) -> Result<String, NoFrame> {
    let bytes = short_of(rest)?;
    std::str::from_utf8(bytes)
        .map(str::to_owned)
        .map_err(|_| NoFrame)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn told(message: &Message) -> OutgoingMessage<'_> {
        OutgoingMessage {
            topic: &message.topic,
            payload: &message.payload,
            retained: message.retained,
            content_type: message.content_type.as_deref(),
            properties: &message.properties,
        }
    }

    prop_compose! {
        fn message()(
            topic in proptest::collection::vec(any::<u8>(), 0..40),
            payload in proptest::collection::vec(any::<u8>(), 0..300),
            retained: bool,
            content_type in proptest::option::of(".{0,12}"),
            properties in proptest::collection::vec((".{0,8}", ".{0,8}"), 0..3),
        ) -> Message {
            Message { topic, payload, retained, content_type, properties }
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            sender in "[a-z0-9]{0,20}",
            messages in proptest::collection::vec(message(), 0..10),
        ) {
            let mut frame = begin(&sender);
            for m in &messages {
                prop_assert!(put(&mut frame, told(m)));
            }
            prop_assert_eq!(read(&frame), Ok((sender.as_str(), messages)));
        }

        #[test]
        fn anything_is_read_or_refused(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = read(&noise);
        }

        /// Cut anywhere, a frame holds the messages before the cut or is none.
        #[test]
        fn a_frame_that_is_cut_says_nothing_new(
            messages in proptest::collection::vec(message(), 1..5),
            cut: proptest::sample::Index,
        ) {
            let mut frame = begin("s");
            for m in &messages {
                put(&mut frame, told(m));
            }
            let cut = &frame[..cut.index(frame.len())];
            if let Ok((_, read)) = read(cut) {
                prop_assert_eq!(&read[..], &messages[..read.len()]);
            }
        }
    }

    #[test]
    fn what_has_no_room_leaves_the_frame_as_it_was() {
        let mut frame = begin("s");
        let before = frame.clone();
        let plain = Message {
            topic: b"t".to_vec(),
            payload: b"x".to_vec(),
            retained: false,
            content_type: None,
            properties: Vec::new(),
        };
        let long = Message {
            topic: vec![0; 70_000],
            ..plain.clone()
        };
        assert!(!put(&mut frame, told(&long)));
        let many = Message {
            properties: vec![(String::new(), String::new()); 256],
            ..plain
        };
        assert!(!put(&mut frame, told(&many)));
        assert_eq!(frame, before);
    }
}
