//! What the broker's library gets wrong of MQTT, put right on the way to it.
//!
//! - A publish with a *message expiry interval* of zero is allowed (section 3.3.2.3.3). The library takes
//!   it for malformed and ends the session, so it is changed to a second.
//! - No topic alias is announced, so one that is used ends the session with *topic alias invalid*
//!   (section 3.3.2.3.4). The library would take the publish without looking the alias up.
//! - Nothing comes after a DISCONNECT (section 3.14.4; MQTT 3.1.1, section 3.14.4), whether its sender closes
//!   the connection or not. The library would wait for more of it for ever.
//!
//! Packets are read as they pass, whatever pieces they come in. What is malformed is left to the broker.

/// A packet of the control type PUBLISH, and where its flags have the QoS (section 3.3.1).
const PUBLISH: u8 = 0x30;
const QOS: u8 = 0x06;

/// A packet of the control type DISCONNECT.
const DISCONNECT: u8 = 0xe0;

/// The client has used a topic alias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TopicAlias;

/// A stream of packets of MQTT.
#[derive(Debug)]
pub(super) struct Packets {
    stage: Stage,
    /// Bytes of the packet that are still to come, once its length is known.
    left: u32,
    /// Whether publishes are looked into, or packets only told apart.
    into: bool,
    /// Whether the packet that has begun is a DISCONNECT.
    last: bool,
    over: bool,
}

#[derive(Debug)]
enum Stage {
    /// Between two packets.
    Between,
    Length {
        first: u8,
        number: Variable,
    },
    /// The length of a topic, of which `high` is known.
    Topic {
        qos: bool,
        high: Option<u8>,
    },
    /// Topic and packet identifier.
    Skip(u32),
    PropertiesLength(Variable),
    Properties(Properties),
    /// Everything up to the end of the packet.
    Rest,
}

impl Packets {
    /// Those of a client that speaks MQTT 5.
    pub(super) const fn looked_into() -> Self {
        Self {
            into: true,
            ..Self::told_apart()
        }
    }

    /// Those of the broker, and of clients whose publishes have no properties.
    pub(super) const fn told_apart() -> Self {
        Self {
            stage: Stage::Between,
            left: 0,
            into: false,
            last: false,
            over: false,
        }
    }

    /// Whether their sender has said that no more will come.
    pub(super) const fn are_over(&self) -> bool {
        self.over
    }

    /// Whether a packet has ended and no other has begun.
    pub(super) const fn is_between(&self) -> bool {
        matches!(self.stage, Stage::Between)
    }

    /// Reads what comes next and changes what has to be. Tells how many of these bytes count: all of them, up
    /// to the end of a DISCONNECT.
    ///
    /// # Errors
    /// [`TopicAlias`]; what comes after it is not looked at.
    pub(super) fn pass(&mut self, bytes: &mut [u8]) -> Result<usize, TopicAlias> {
        let mut at = 0;
        while !self.over
            && let Some(rest) = bytes.get_mut(at..).filter(|rest| !rest.is_empty())
        {
            at += self.step(rest)?;
        }
        Ok(at)
    }

    /// How many of these bytes belong to the packet that has begun; all of them when it goes on.
    pub(super) fn finish(&mut self, bytes: &mut [u8]) -> usize {
        let mut at = 0;
        while !self.is_between()
            && let Some(rest) = bytes.get_mut(at..).filter(|rest| !rest.is_empty())
        {
            let all = rest.len();
            at += self.step(rest).unwrap_or(all);
        }
        at
    }

    /// Reads at least one byte and tells how many.
    fn step(&mut self, bytes: &mut [u8]) -> Result<usize, TopicAlias> {
        let Some(byte) = bytes.first_mut() else {
            return Ok(0);
        };
        let mut taken = 1;
        match &mut self.stage {
            Stage::Between => {
                self.stage = Stage::Length {
                    first: *byte,
                    number: Variable::default(),
                };
                return Ok(1);
            }
            Stage::Length { first, number } => {
                if let Some(length) = number.pass(*byte) {
                    self.left = length;
                    self.last = *first & 0xf0 == DISCONNECT;
                    self.stage = if self.into && *first & 0xf0 == PUBLISH {
                        let qos = *first & QOS != 0;
                        Stage::Topic { qos, high: None }
                    } else {
                        Stage::Rest
                    };
                    self.end();
                }
                return Ok(1);
            }
            Stage::Topic { qos, high } => match *high {
                None => *high = Some(*byte),
                Some(high) => {
                    let topic = u32::from(u16::from_be_bytes([high, *byte]));
                    let identifier = if *qos { 2 } else { 0 };
                    self.stage = match topic + identifier {
                        0 => Stage::PropertiesLength(Variable::default()),
                        count => Stage::Skip(count),
                    };
                }
            },
            Stage::Skip(count) => {
                let most = usize::try_from(*count.min(&mut self.left)).unwrap_or(usize::MAX);
                taken = bytes.len().min(most);
                *count -= taken as u32;
                if *count == 0 {
                    self.stage = Stage::PropertiesLength(Variable::default());
                }
            }
            Stage::PropertiesLength(number) => {
                if let Some(length) = number.pass(*byte) {
                    self.stage = match length {
                        0 => Stage::Rest,
                        length => Stage::Properties(Properties::new(length)),
                    };
                }
            }
            Stage::Properties(properties) => {
                if properties.pass(byte)? {
                    self.stage = Stage::Rest;
                }
            }
            Stage::Rest => {
                let most = usize::try_from(self.left).unwrap_or(usize::MAX);
                taken = bytes.len().min(most);
            }
        }
        self.left = self.left.saturating_sub(taken as u32);
        self.end();
        Ok(taken)
    }

    fn end(&mut self) {
        if self.left == 0 {
            self.stage = Stage::Between;
            self.over = self.last;
        }
    }
}

/// A variable byte integer (section 1.5.5).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Variable {
    value: u32,
    shift: u32,
}

impl Variable {
    /// Takes one byte; the number, when that was the last.
    pub(super) const fn pass(&mut self, byte: u8) -> Option<u32> {
        // More than four bytes are malformed, and the broker ends the session.
        if self.shift < 28 {
            self.value |= ((byte & 0x7f) as u32) << self.shift;
            self.shift += 7;
        }
        if byte < 0x80 { Some(self.value) } else { None }
    }
}

/// The properties of a publish or a will (section 2.2.2).
#[derive(Debug)]
pub(super) struct Properties {
    left: u32,
    item: Item,
}

#[derive(Debug)]
enum Item {
    Id,
    Skip(u32),
    /// A message expiry interval. Whether all of it has been zero so far.
    Expiry {
        left: u8,
        zero: bool,
    },
    Number,
    /// A length of which `high` is known, and whether another string follows.
    Length {
        high: Option<u8>,
        pair: bool,
    },
    Text {
        left: u32,
        pair: bool,
    },
    /// Not to be understood; the broker looks at it.
    Unknown,
}

impl Properties {
    /// So many bytes of properties.
    pub(super) const fn new(length: u32) -> Self {
        Self {
            left: length,
            item: Item::Id,
        }
    }

    /// Reads one byte, and changes it if it has to be. True when it was the last.
    ///
    /// # Errors
    /// [`TopicAlias`].
    pub(super) fn pass(&mut self, byte: &mut u8) -> Result<bool, TopicAlias> {
        self.item = match &mut self.item {
            Item::Id => match *byte {
                // Payload format.
                0x01 => Item::Skip(1),
                0x02 => Item::Expiry {
                    left: 4,
                    zero: true,
                },
                // Content type, response topic, correlation data.
                0x03 | 0x08 | 0x09 => Item::Length {
                    high: None,
                    pair: false,
                },
                // Subscription identifier.
                0x0b => Item::Number,
                // Will delay interval.
                0x18 => Item::Skip(4),
                0x23 => return Err(TopicAlias),
                // User property.
                0x26 => Item::Length {
                    high: None,
                    pair: true,
                },
                _ => Item::Unknown,
            },
            Item::Skip(left) => match *left {
                1 => Item::Id,
                left => Item::Skip(left - 1),
            },
            Item::Expiry { left, zero } => {
                let zero = *zero && *byte == 0;
                if *left > 1 {
                    Item::Expiry {
                        left: *left - 1,
                        zero,
                    }
                } else {
                    *byte |= u8::from(zero);
                    Item::Id
                }
            }
            Item::Number if *byte < 0x80 => Item::Id,
            Item::Number => Item::Number,
            Item::Length { high: None, pair } => Item::Length {
                high: Some(*byte),
                pair: *pair,
            },
            Item::Length {
                high: Some(high),
                pair,
            } => Self::text(u32::from(u16::from_be_bytes([*high, *byte])), *pair),
            Item::Text { left, pair } => Self::text(*left - 1, *pair),
            Item::Unknown => Item::Unknown,
        };
        self.left = self.left.saturating_sub(1);
        Ok(self.left == 0)
    }

    /// What follows when so many bytes of a string are still to come.
    const fn text(left: u32, pair: bool) -> Item {
        match (left, pair) {
            (0, false) => Item::Id,
            (0, true) => Item::Length {
                high: None,
                pair: false,
            },
            (left, pair) => Item::Text { left, pair },
        }
    }
}

#[cfg(test)]
#[path = "packets_tests.rs"]
mod tests;
