//! Topics as numbers, on the way to clients that take them (MQTT 5, section 3.3.2.3.4).
//!
//! A release goes to a robot in hundreds of messages of a kilobyte that differ in everything but their topic, which is as
//! long as all else around them. The library would give a number to whichever topic comes first and never take
//! it back, so it is not asked to: here the topic of the last large message at QoS 0 has the one number that there
//! is. Small messages keep their topics, for which the next large one would have to be explained anew.
//!
//! Packets are read as they pass, whatever pieces they come in. Of a publish at QoS 0 the head is held back until its
//! properties begin; what cannot be read is passed on as it is.

use super::packets::Variable;

/// The number.
const ALIAS: [u8; 3] = [0x23, 0, 1];
/// Messages are large from so many bytes on: behind them a topic more or less counts for a robot that receives
/// hundreds.
const LARGE: u32 = 512;
/// A head that is longer has a topic of nobody's, or properties that nobody uses.
const LONGEST_HEAD: usize = 256;
/// The properties of a publish with the number may have so many bytes: their length has one then, as before.
const LONGEST_PROPERTIES: u8 = 127 - ALIAS.len() as u8;

/// PUBLISH at QoS 0, but for the retain flag (section 3.3.1).
const PUBLISH: u8 = 0x30;
const RETAIN: u8 = 0x01;

/// What a client says in its CONNECT of what it takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Announced {
    /// How many topic aliases.
    pub(super) aliases: u16,
    /// Bytes of a packet.
    pub(super) largest: u32,
}

impl Announced {
    /// Reads the properties of a CONNECT of MQTT 5 (section 3.1.2.11). Of one that cannot be read, nothing is announced.
    pub(super) fn of(connect: &[u8]) -> Self {
        let mut announced = Self {
            aliases: 0,
            largest: u32::MAX,
        };
        if announced.read(connect).is_none() {
            announced.aliases = 0;
        }
        announced
    }

    fn read(&mut self, connect: &[u8]) -> Option<()> {
        let (_, head) = number(connect, 1)?;
        // Behind the name with its length, level, flags and keep alive.
        let (length, begin) = number(connect, head + 10)?;
        let mut rest = connect.get(begin..begin.checked_add(length)?)?;
        while let Some((id, behind)) = rest.split_first() {
            let value = match id {
                // Request problem information, request response information.
                0x17 | 0x19 => 1,
                // Receive maximum, topic alias maximum.
                0x21 | 0x22 => 2,
                // Session expiry interval, maximum packet size.
                0x11 | 0x27 => 4,
                // Authentication method and data; user property.
                0x15 | 0x16 => 2 + usize::from(short(behind)?),
                0x26 => {
                    let name = 2 + usize::from(short(behind)?);
                    name + 2 + usize::from(short(behind.get(name..)?)?)
                }
                _ => return None,
            };
            let (value, next) = behind.split_at_checked(value)?;
            match (id, value) {
                (0x22, [high, low]) => self.aliases = u16::from_be_bytes([*high, *low]),
                (0x27, [a, b, c, d]) => self.largest = u32::from_be_bytes([*a, *b, *c, *d]),
                _ => {}
            }
            rest = next;
        }
        Some(())
    }
}

fn short(bytes: &[u8]) -> Option<u16> {
    let [high, low] = *bytes.first_chunk()?;
    Some(u16::from_be_bytes([high, low]))
}

/// The variable byte integer at `at`, and where it ends.
fn number(bytes: &[u8], at: usize) -> Option<(usize, usize)> {
    let mut number = Variable::default();
    let bytes = bytes.get(at..)?.iter().take(4);
    bytes.enumerate().find_map(|(index, byte)| {
        let value = number.pass(*byte)?;
        Some((value as usize, at + index + 1))
    })
}

/// What a client is sent.
#[derive(Debug)]
pub(super) struct Aliases {
    largest: u32,
    stage: Stage,
    /// What is held back of the packet that has begun.
    head: Vec<u8>,
    /// The topic that has the number.
    topic: Vec<u8>,
}

#[derive(Debug, Clone, Copy)]
enum Stage {
    /// The first byte and the length of a packet.
    Length(Variable),
    /// The head of a large publish, of which so many bytes are still to come with all else.
    Head(u32),
    /// So many bytes that are passed on.
    Rest(u32),
}

impl Aliases {
    /// For a client that takes them.
    pub(super) fn new(announced: Announced) -> Option<Self> {
        (announced.aliases > 0).then(|| Self {
            largest: announced.largest,
            stage: Stage::Length(Variable::default()),
            head: Vec::new(),
            topic: Vec::new(),
        })
    }

    /// Takes what the broker says, and adds to `out` what the client is to be sent.
    pub(super) fn pass(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        let mut rest = bytes;
        while let Some((byte, behind)) = rest.split_first() {
            match self.stage {
                Stage::Rest(left) => {
                    let count = rest.len().min(usize::try_from(left).unwrap_or(usize::MAX));
                    let (now, next) = rest.split_at(count);
                    out.extend_from_slice(now);
                    rest = next;
                    self.rest(left - count as u32);
                }
                Stage::Length(mut number) => {
                    self.head.push(*byte);
                    rest = behind;
                    if self.head.len() == 1 {
                        continue;
                    }
                    match number.pass(*byte) {
                        None => self.stage = Stage::Length(number),
                        Some(length) if self.is_large_publish(length) => {
                            self.stage = Stage::Head(length);
                        }
                        Some(length) => self.give_up(length, out),
                    }
                }
                Stage::Head(left) => {
                    self.head.push(*byte);
                    rest = behind;
                    self.stage = Stage::Head(left - 1);
                    if self.head.len() > LONGEST_HEAD || left == 1 {
                        self.give_up(left - 1, out);
                    } else if let Some(head) = Head::of(&self.head) {
                        self.write(head, left - 1, out);
                    }
                }
            }
        }
    }

    fn is_large_publish(&self, length: u32) -> bool {
        let first = self.head.first().copied().unwrap_or_default();
        first & !RETAIN == PUBLISH && length >= LARGE
    }

    /// Passes the head on as it is, with so many bytes that follow it.
    fn give_up(&mut self, left: u32, out: &mut Vec<u8>) {
        out.append(&mut self.head);
        self.rest(left);
    }

    fn rest(&mut self, left: u32) {
        self.stage = match left {
            0 => Stage::Length(Variable::default()),
            left => Stage::Rest(left),
        };
    }

    /// Passes the head on with the number, beside the topic or in its place.
    fn write(&mut self, head: Head, left: u32, out: &mut Vec<u8>) {
        let known = head.topic_len > 0 && head.topic(&self.head) == self.topic;
        let kept = if known { 0 } else { head.topic_len };
        let properties = usize::from(head.properties) + ALIAS.len();
        // Topic and properties with their lengths, and what follows: properties and payload.
        let body = 2 + kept + 1 + ALIAS.len() + left as usize;
        let fits = head.properties <= LONGEST_PROPERTIES && body + 5 <= self.largest as usize;
        if head.topic_len == 0 || !fits {
            return self.give_up(left, out);
        }
        out.push(self.head.first().copied().unwrap_or(PUBLISH));
        let mut length = body;
        while length >= 0x80 {
            out.push(length as u8 | 0x80);
            length >>= 7;
        }
        out.push(length as u8);
        out.extend_from_slice(&(kept as u16).to_be_bytes());
        if !known {
            let topic = head.topic(&self.head);
            out.extend_from_slice(topic);
            self.topic = topic.to_vec();
        }
        out.push(properties as u8);
        out.extend_from_slice(&ALIAS);
        self.head.clear();
        self.rest(left);
    }
}

/// Where things are in the head of a publish at QoS 0: up to its properties, which follow it.
#[derive(Debug, Clone, Copy)]
struct Head {
    topic_at: usize,
    topic_len: usize,
    /// Bytes of its properties.
    properties: u8,
}

impl Head {
    /// `None` when it is not all there. Properties whose length takes more than a byte are longer than any.
    fn of(bytes: &[u8]) -> Option<Self> {
        let (_, body) = number(bytes, 1)?;
        let topic_len = usize::from(short(bytes.get(body..)?)?);
        let topic_at = body + 2;
        let properties = *bytes.get(topic_at + topic_len)?;
        Some(Self {
            topic_at,
            topic_len,
            properties,
        })
    }

    fn topic(self, bytes: &[u8]) -> &[u8] {
        let range = self.topic_at..self.topic_at + self.topic_len;
        bytes.get(range).unwrap_or_default()
    }
}

#[cfg(test)]
#[path = "aliases_tests.rs"]
mod tests;
