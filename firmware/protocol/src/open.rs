//! What robots say, as readers take it that may be older than the robot.
//!
//! A robot may speak a later version of this contract than the program that hears it. Such a reader
//! passes over fields that it does not know and keeps words that it does not know as text, and says of
//! how many it knew nothing. What it does know it reads as strictly as ever, within the same bounds:
//! [`MAX_MESSAGE`] bytes and [`MAX_DEPTH`](crate::MAX_DEPTH) levels.
//!
//! The names are those of the strict messages: [`open::Telemetry`](Telemetry) is read here what
//! [`crate::Telemetry`] is written as there.

mod update;

use core::fmt;

use serde::de::{self, DeserializeOwned, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::json::{self, Tolerant};
use crate::message::{Sample, cbor};
use crate::{
    BehaviourName, BootCause, Capability, DecodeError, Detections, Kind, Level, MAX_MESSAGE,
    MapSegment, ParametersMessage, Reason, ResponseStatus, RobotState,
};

pub use crate::words::Words;
pub use update::{Update, UpdateReport, update};

/// Most bytes that are kept of a word that is not known.
pub const MAX_WORD: usize = 24;

/// A [`crate::Response`] whose words may be later ones.
pub type Response = crate::Response<Open<ResponseStatus>, Open<Reason>>;
/// A [`crate::Boot`] whose words may be later ones.
pub type Boot = crate::Boot<Open<BootCause>>;
/// A [`crate::StatusMessage`] whose words may be later ones.
pub type StatusMessage = crate::StatusMessage<Open<Kind>, Open<Capability>, Open<BootCause>>;
/// A [`crate::Telemetry`] whose words may be later ones.
pub type Telemetry = crate::Telemetry<Open<RobotState>, Open<BehaviourName>>;
/// A [`crate::Heartbeat`] whose words may be later ones.
pub type Heartbeat = crate::Heartbeat<Open<RobotState>>;
/// A [`crate::LogRecord`] whose words may be later ones.
pub type LogRecord = crate::LogRecord<Open<Level>>;

/// A word of a later version of the contract: printable ASCII without space, and cut to [`MAX_WORD`]
/// bytes.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct UnknownWord {
    bytes: [u8; MAX_WORD],
    length: u8,
}

impl UnknownWord {
    /// What can be kept of `text`. A character that is not printable ASCII becomes a question mark.
    #[must_use]
    pub fn new(text: &str) -> Self {
        let mut bytes = [0; MAX_WORD];
        let mut length = 0;
        for (place, character) in bytes.iter_mut().zip(text.chars()) {
            *place = match u8::try_from(character) {
                Ok(byte) if byte.is_ascii_graphic() => byte,
                _ => b'?',
            };
            length += 1;
        }
        Self { bytes, length }
    }

    /// The word.
    #[must_use]
    pub fn as_str(&self) -> &str {
        let bytes = self.bytes.get(..usize::from(self.length));
        // Every byte is ASCII.
        core::str::from_utf8(bytes.unwrap_or_default()).unwrap_or_default()
    }
}

impl fmt::Debug for UnknownWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// A word that this version of the contract may not have yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Open<T> {
    /// It has it.
    Known(T),
    /// It does not.
    Unknown(UnknownWord),
}

impl<T: Words> Open<T> {
    /// The word of this name.
    #[must_use]
    pub fn named(name: &str) -> Self {
        let mut all = T::VALUES.iter();
        match all.find(|value| value.word() == name) {
            Some(known) => Self::Known(*known),
            None => Self::Unknown(UnknownWord::new(name)),
        }
    }

    /// The name on the wire.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Known(known) => known.word(),
            Self::Unknown(word) => word.as_str(),
        }
    }
}

impl<T> Open<T> {
    /// The word where this version of the contract has it.
    #[must_use]
    pub fn known(self) -> Option<T> {
        match self {
            Self::Known(known) => Some(known),
            Self::Unknown(_) => None,
        }
    }

    /// A word of which only the number is known, as text.
    pub(crate) fn of_number(number: u8) -> Self {
        let mut text = heapless::String::<3>::new();
        // Three digits are enough for every byte.
        let _ = fmt::Write::write_fmt(&mut text, format_args!("{number}"));
        Self::Unknown(UnknownWord::new(&text))
    }

    /// 1 where the word is not known.
    const fn unknown(&self) -> u32 {
        matches!(self, Self::Unknown(_)) as u32
    }
}

impl Open<ResponseStatus> {
    /// Whether no further answer to the command follows. Behind a status that is not known one may.
    #[must_use]
    pub const fn is_final(self) -> bool {
        match self {
            Self::Known(status) => status.is_final(),
            Self::Unknown(_) => false,
        }
    }
}

impl<T> From<T> for Open<T> {
    fn from(known: T) -> Self {
        Self::Known(known)
    }
}

impl<T: PartialEq> PartialEq<T> for Open<T> {
    fn eq(&self, other: &T) -> bool {
        matches!(self, Self::Known(known) if known == other)
    }
}

impl<T: Words> fmt::Display for Open<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl<T: Words> Serialize for Open<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de, T: Words> Deserialize<'de> for Open<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct WordVisitor<T>(core::marker::PhantomData<T>);

        impl<T: Words> Visitor<'_> for WordVisitor<T> {
            type Value = Open<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a word")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Self::Value, E> {
                Ok(Open::named(text))
            }
        }

        deserializer.deserialize_str(WordVisitor(core::marker::PhantomData))
    }
}

/// Of how much a reader knew nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Unknown {
    /// Fields that were passed over.
    pub fields: u32,
    /// Words that were kept as text.
    pub words: u32,
}

impl Unknown {
    /// Whether everything was known.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.fields == 0 && self.words == 0
    }

    /// Counts what another message had.
    pub const fn add(&mut self, other: Self) {
        self.fields = self.fields.saturating_add(other.fields);
        self.words = self.words.saturating_add(other.words);
    }
}

/// A message, and of how much of it the reader knew nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Read<T> {
    /// What it says.
    pub message: T,
    /// What it says beside that.
    pub unknown: Unknown,
}

/// A message of a robot that can be read without knowing all of it.
pub trait Report: DeserializeOwned {
    /// How many of its words are not known.
    fn unknown_words(&self) -> u32;
}

impl Report for Response {
    fn unknown_words(&self) -> u32 {
        let reason = self.reason.as_ref().map_or(0, Open::unknown);
        self.status.unknown() + reason
    }
}

impl Report for StatusMessage {
    fn unknown_words(&self) -> u32 {
        let capabilities = self.capabilities.iter().map(Open::unknown);
        self.kind.unknown() + self.boot.cause.unknown() + capabilities.sum::<u32>()
    }
}

impl Report for Telemetry {
    fn unknown_words(&self) -> u32 {
        self.state.unknown() + self.behaviour.unknown()
    }
}

impl Report for Heartbeat {
    fn unknown_words(&self) -> u32 {
        self.state.unknown()
    }
}

impl Report for LogRecord {
    fn unknown_words(&self) -> u32 {
        self.level.unknown()
    }
}

impl Report for Detections {
    fn unknown_words(&self) -> u32 {
        0
    }
}

impl Report for MapSegment {
    fn unknown_words(&self) -> u32 {
        0
    }
}

impl Report for ParametersMessage {
    fn unknown_words(&self) -> u32 {
        0
    }
}

/// Reads a message, in JSON, from the whole of `payload`.
///
/// # Errors
/// [`DecodeError`] names what is wrong with what is known of it; never
/// [`DecodeError::UnknownField`].
pub fn read<T: Report>(payload: &[u8]) -> Result<Read<T>, DecodeError> {
    let (message, tolerant): (T, _) = json::read(payload, Tolerant::default())?;
    Ok(told(message, &tolerant))
}

fn told<T: Report>(message: T, tolerant: &Tolerant) -> Read<T> {
    let unknown = Unknown {
        fields: tolerant.fields,
        words: message.unknown_words(),
    };
    Read { message, unknown }
}

impl Sample for Read<Telemetry> {
    fn read_json(payload: &[u8]) -> Result<Self, DecodeError> {
        read(payload)
    }

    fn read_cbor(payload: &[u8]) -> Result<Self, DecodeError> {
        if payload.len() > MAX_MESSAGE {
            return Err(DecodeError::TooLarge);
        }
        let mut tolerant = Tolerant::default();
        let message = cbor::read_whole(payload, &mut tolerant)?;
        Ok(told(message, &tolerant))
    }

    fn next_cbor(decoder: &mut minicbor::Decoder<'_>) -> Result<Self, DecodeError> {
        let mut tolerant = Tolerant::default();
        let message = cbor::read(decoder, &mut tolerant)?;
        Ok(told(message, &tolerant))
    }

    fn seq(&self) -> u64 {
        self.message.seq
    }
}
