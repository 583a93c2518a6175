//! JSON without heap.
//!
//! Reading is strict: one value, in UTF-8, of at most [`MAX_MESSAGE`] bytes and [`MAX_DEPTH`]
//! levels, with nothing after it. What is not JSON is always called [`DecodeError::Malformed`],
//! whatever it seems to say: when a value is refused, a second pass over the whole text tells whether
//! the syntax is to blame. A value that is taken has been read to its end by the grammar, so that what robots
//! hear most is read once.

mod de;
mod read;
mod ser;

use core::fmt;

pub(crate) use de::{Strict, Strictness, Tolerant};
pub(crate) use read::{Reader, Text, Value};
use serde::{Deserialize, Serialize};

use crate::{MAX_MESSAGE, Reason};

/// Levels of objects and arrays in one message. Messages of this contract have three.
pub const MAX_DEPTH: u8 = 8;

/// Why a message cannot be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EncodeError {
    /// It does not fit the buffer, or is more than [`MAX_MESSAGE`] bytes.
    TooLarge,
    /// A number that must be there is not finite; JSON has no text for it.
    NotFinite,
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooLarge => "the message is too large",
            Self::NotFinite => "a number is not finite",
        })
    }
}

impl core::error::Error for EncodeError {}

/// Why bytes are not the message they should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeError {
    /// Not one JSON value in UTF-8, too many levels of it, or something after it.
    Malformed,
    /// More than [`MAX_MESSAGE`] bytes.
    TooLarge,
    /// A field that the message does not have.
    UnknownField,
    /// One field twice.
    DuplicateField,
    /// A field that must be there is not.
    MissingField,
    /// A field holds another type than it must.
    WrongType,
    /// The right type, and a value that is not allowed.
    OutOfRange,
}

impl DecodeError {
    /// The same as it is said on the wire.
    #[must_use]
    pub const fn reason(self) -> Reason {
        match self {
            Self::Malformed => Reason::Malformed,
            Self::TooLarge => Reason::TooLarge,
            Self::UnknownField => Reason::UnknownField,
            Self::DuplicateField => Reason::DuplicateField,
            Self::MissingField => Reason::MissingField,
            Self::WrongType => Reason::WrongType,
            Self::OutOfRange => Reason::OutOfRange,
        }
    }
}

impl From<DecodeError> for Reason {
    fn from(error: DecodeError) -> Self {
        error.reason()
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason().name())
    }
}

impl core::error::Error for DecodeError {}

/// Writes `value` to the front of `buf`, at most [`MAX_MESSAGE`] bytes, and returns how many.
///
/// # Errors
/// See [`EncodeError`].
pub fn to_slice<T: Serialize + ?Sized>(value: &T, buf: &mut [u8]) -> Result<usize, EncodeError> {
    let most = buf.len().min(MAX_MESSAGE);
    let room = buf.get_mut(..most).ok_or(EncodeError::TooLarge)?;
    let mut serializer = ser::Serializer::new(room);
    value.serialize(&mut serializer)?;
    Ok(serializer.written())
}

/// Reads a value from the whole of `payload`.
///
/// # Errors
/// See [`DecodeError`].
pub fn from_slice<'de, T: Deserialize<'de>>(payload: &'de [u8]) -> Result<T, DecodeError> {
    read(payload, Strict).map(|(value, _)| value)
}

/// The same, with what is to be done about fields that the value does not have; and what was done.
pub(crate) fn read<'de, T: Deserialize<'de>, S: Strictness>(
    payload: &'de [u8],
    strictness: S,
) -> Result<(T, S), DecodeError> {
    if payload.len() > MAX_MESSAGE {
        return Err(DecodeError::TooLarge);
    }
    let text = core::str::from_utf8(payload).map_err(|_| DecodeError::Malformed)?;
    let mut deserializer = de::Deserializer::new(text, strictness);
    let value = T::deserialize(&mut deserializer).and_then(|value| {
        deserializer.end()?;
        Ok(value)
    });
    // What was passed over is known to be JSON, and not how deep it lay.
    if value.is_err() || deserializer.has_skipped() {
        prove(text)?;
    }
    Ok((value?, deserializer.strictness))
}

/// Proves that a text is one value of at most [`MAX_DEPTH`] levels.
///
/// # Errors
/// [`DecodeError::Malformed`] when it is not.
pub(crate) fn prove(text: &str) -> Result<(), DecodeError> {
    let mut proof = Reader::new(text);
    proof.skip(MAX_DEPTH)?;
    proof.end()
}
