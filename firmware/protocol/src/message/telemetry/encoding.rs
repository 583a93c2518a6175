//! The ways telemetry may be written, told apart by the content type of its message.

use core::marker::PhantomData;

use minicbor::Decoder;

use super::{Telemetry, cbor};
use crate::json::Strict;
use crate::open::{self, Read};
use crate::{DecodeError, EncodeError, MAX_MESSAGE};

/// Most samples of one message.
pub const MAX_BATCH: usize = 10;

/// What begins a text of a JSON sequence (RFC 7464): the record separator.
const SEPARATOR: u8 = 0x1E;

/// How the telemetry of one message is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TelemetryEncoding {
    /// One sample as JSON. The only one that needs no content type.
    Json,
    /// Samples as a sequence of JSON texts (RFC 7464).
    JsonSeq,
    /// One sample as CBOR (RFC 8949).
    Cbor,
    /// Samples as a CBOR sequence (RFC 8742).
    CborSeq,
}

impl TelemetryEncoding {
    /// Every encoding.
    pub const ALL: [Self; 4] = [Self::Json, Self::JsonSeq, Self::Cbor, Self::CborSeq];

    /// The content type of a message that is written so.
    #[must_use]
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::JsonSeq => "application/json-seq",
            Self::Cbor => "application/cbor",
            Self::CborSeq => "application/cbor-seq",
        }
    }

    /// How a message with this content type is written; `None` when telemetry is not written so.
    /// Parameters of the type are of no consequence.
    #[must_use]
    pub fn of(content_type: Option<&str>) -> Option<Self> {
        let Some(text) = content_type else {
            return Some(Self::Json);
        };
        let kind = text.split(';').next().unwrap_or_default().trim();
        Self::ALL
            .into_iter()
            .find(|encoding| encoding.content_type().eq_ignore_ascii_case(kind))
    }

    /// Whether a message holds any number of samples.
    #[must_use]
    pub const fn is_sequence(self) -> bool {
        matches!(self, Self::JsonSeq | Self::CborSeq)
    }

    /// Writes `sample` behind the first `at` bytes of `buf`, which hold those before it, and returns
    /// the length of it all. Without success those before it are as they were.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when it does not fit `buf` or [`MAX_MESSAGE`], or would be the second
    /// of a message that holds one; [`EncodeError::NotFinite`] when a number that must be there is
    /// not one.
    pub fn append(
        self,
        sample: &Telemetry,
        buf: &mut [u8],
        at: usize,
    ) -> Result<usize, EncodeError> {
        if at > 0 && !self.is_sequence() {
            return Err(EncodeError::TooLarge);
        }
        let most = buf.len().min(MAX_MESSAGE);
        let room = buf.get_mut(at..most).ok_or(EncodeError::TooLarge)?;
        let length = match self {
            Self::Json => sample.to_json(room)?,
            Self::Cbor | Self::CborSeq => sample.to_cbor(room)?,
            Self::JsonSeq => {
                let (first, rest) = room.split_first_mut().ok_or(EncodeError::TooLarge)?;
                *first = SEPARATOR;
                let length = sample.to_json(rest)?;
                *rest.get_mut(length).ok_or(EncodeError::TooLarge)? = b'\n';
                length + 2
            }
        };
        Ok(at + length)
    }

    /// The samples of a message, oldest first: at least one, and at most [`MAX_BATCH`]. The first
    /// that cannot be read is the last, and the message is then worth nothing.
    #[must_use]
    pub const fn samples(self, payload: &[u8]) -> Samples<'_> {
        Samples::new(self, payload)
    }

    /// The same for a reader that may be older than the robot; see [`crate::open`].
    #[must_use]
    pub const fn open_samples(self, payload: &[u8]) -> Samples<'_, Read<open::Telemetry>> {
        Samples::new(self, payload)
    }
}

/// A sample as it is read, strictly or not.
pub trait Sample: Sized {
    /// Reads one from JSON.
    fn read_json(payload: &[u8]) -> Result<Self, DecodeError>;

    /// Reads one from CBOR.
    fn read_cbor(payload: &[u8]) -> Result<Self, DecodeError>;

    /// Reads the next of a sequence in CBOR.
    fn next_cbor(decoder: &mut Decoder<'_>) -> Result<Self, DecodeError>;

    /// Its number.
    fn seq(&self) -> u64;
}

impl Sample for Telemetry {
    fn read_json(payload: &[u8]) -> Result<Self, DecodeError> {
        Self::from_json(payload)
    }

    fn read_cbor(payload: &[u8]) -> Result<Self, DecodeError> {
        Self::from_cbor(payload)
    }

    fn next_cbor(decoder: &mut Decoder<'_>) -> Result<Self, DecodeError> {
        cbor::read(decoder, &mut Strict)
    }

    fn seq(&self) -> u64 {
        self.seq
    }
}

/// See [`TelemetryEncoding::samples`].
#[derive(Debug, Clone)]
pub struct Samples<'a, T = Telemetry> {
    encoding: TelemetryEncoding,
    rest: &'a [u8],
    count: usize,
    /// Number of the sample before.
    last: Option<u64>,
    over: bool,
    what: PhantomData<fn() -> T>,
}

impl<'a, T> Samples<'a, T> {
    const fn new(encoding: TelemetryEncoding, payload: &'a [u8]) -> Self {
        Self {
            encoding,
            rest: payload,
            count: 0,
            last: None,
            over: false,
            what: PhantomData,
        }
    }
}

impl<T: Sample> Samples<'_, T> {
    fn read(&mut self) -> Result<T, DecodeError> {
        // At the first sample what is left is the whole message.
        if self.rest.len() > MAX_MESSAGE || self.count == MAX_BATCH {
            return Err(DecodeError::TooLarge);
        }
        self.count += 1;
        let sample = match self.encoding {
            TelemetryEncoding::Json => T::read_json(self.rest)?,
            TelemetryEncoding::Cbor => T::read_cbor(self.rest)?,
            TelemetryEncoding::JsonSeq => {
                let rest = self.rest.strip_prefix(&[SEPARATOR]);
                let rest = rest.ok_or(DecodeError::Malformed)?;
                let next = rest.iter().position(|byte| *byte == SEPARATOR);
                let (text, rest) = rest.split_at(next.unwrap_or(rest.len()));
                self.rest = rest;
                T::read_json(text)?
            }
            TelemetryEncoding::CborSeq => {
                let mut decoder = Decoder::new(self.rest);
                let sample = T::next_cbor(&mut decoder)?;
                self.rest = self.rest.get(decoder.position()..).unwrap_or_default();
                sample
            }
        };
        if self.last.is_some_and(|last| sample.seq() <= last) {
            return Err(DecodeError::OutOfRange);
        }
        self.last = Some(sample.seq());
        Ok(sample)
    }
}

impl<T: Sample> Iterator for Samples<'_, T> {
    type Item = Result<T, DecodeError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.over || (self.count > 0 && self.rest.is_empty()) {
            return None;
        }
        let sample = self.read();
        self.over = sample.is_err() || !self.encoding.is_sequence();
        Some(sample)
    }
}

impl<T: Sample> core::iter::FusedIterator for Samples<'_, T> {}
