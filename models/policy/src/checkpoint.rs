//! Checkpoints: all that a run needs to go on, as bytes.
//!
//! ```text
//! "TCRL"  version u16  kind u8  fingerprint [32]  content  SHA-256 of all of that [32]
//! ```
//!
//! Numbers are little-endian. The fingerprint is the SHA-256 of configuration and interface: how long each part of
//! the content is follows from them, so nothing is read, and no memory is taken, on the word of the bytes.

use std::error::Error;
use std::fmt;

use sha2::{Digest, Sha256};

use crate::actor::Progress;

const MAGIC: [u8; 4] = *b"TCRL";
const VERSION: u16 = 1;
const HASH: usize = 32;

/// What bytes hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Ppo = 1,
    Dqn = 2,
    Policy = 3,
}

/// Why bytes cannot be gone on from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CheckpointError {
    /// They are something else.
    Foreign,
    /// Written by another version of this program.
    Version(u16),
    /// Cut off, or changed since they were written.
    Damaged,
    /// Of another algorithm, configuration or environment.
    OtherConfiguration,
    /// A part has a value that no run comes to.
    Invalid(&'static str),
}

impl fmt::Display for CheckpointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Foreign => f.write_str("not a checkpoint"),
            Self::Version(version) => {
                write!(
                    f,
                    "version {version} of the format; this program reads {VERSION}"
                )
            }
            Self::Damaged => f.write_str("damaged: the checksum is another"),
            Self::OtherConfiguration => {
                f.write_str("of another algorithm, configuration or environment")
            }
            Self::Invalid(what) => write!(f, "{what} is invalid"),
        }
    }
}

impl Error for CheckpointError {}

/// Writes a checkpoint, or what a fingerprint is taken of.
#[derive(Debug, Default)]
pub(crate) struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// Begins a checkpoint.
    pub(crate) fn new(kind: Kind, fingerprint: [u8; HASH]) -> Self {
        let mut writer = Self::default();
        writer.bytes.extend_from_slice(&MAGIC);
        writer.bytes.extend_from_slice(&VERSION.to_le_bytes());
        writer.bytes.push(kind as u8);
        writer.bytes.extend_from_slice(&fingerprint);
        writer
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn u64(&mut self, value: u64) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    pub(crate) fn f32s(&mut self, values: &[f32]) {
        self.bytes.reserve(values.len() * 4);
        for value in values {
            self.bytes.extend_from_slice(&value.to_le_bytes());
        }
    }

    pub(crate) fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    pub(crate) fn progress(&mut self, progress: &Progress) {
        self.u32(progress.begun);
        self.u64(progress.taken.len() as u64);
        self.raw(&progress.taken);
    }

    /// The hash of what was written.
    pub(crate) fn hash(&self) -> [u8; HASH] {
        Sha256::digest(&self.bytes).into()
    }

    /// Ends a checkpoint.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        let hash = self.hash();
        self.raw(&hash);
        self.bytes
    }
}

/// Reads a checkpoint.
#[derive(Debug)]
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
    fingerprint: [u8; HASH],
}

impl<'a> Reader<'a> {
    /// Checks all but the content and the fingerprint.
    pub(crate) fn new(bytes: &'a [u8], kind: Kind) -> Result<Self, CheckpointError> {
        let mut reader = Self {
            rest: bytes,
            fingerprint: [0; HASH],
        };
        if reader.array() != Ok(MAGIC) {
            return Err(CheckpointError::Foreign);
        }
        let version = u16::from_le_bytes(reader.array()?);
        if version != VERSION {
            return Err(CheckpointError::Version(version));
        }
        let [found] = reader.array()?;
        reader.fingerprint = reader.array()?;
        let (content, hash) = reader
            .rest
            .split_last_chunk::<HASH>()
            .ok_or(CheckpointError::Damaged)?;
        let hashed = &bytes[..bytes.len() - HASH];
        if Sha256::digest(hashed).as_slice() != hash {
            return Err(CheckpointError::Damaged);
        }
        if found != kind as u8 {
            return Err(CheckpointError::OtherConfiguration);
        }
        reader.rest = content;
        Ok(reader)
    }

    /// Checks the fingerprint.
    pub(crate) fn expect(&self, fingerprint: [u8; HASH]) -> Result<(), CheckpointError> {
        if self.fingerprint == fingerprint {
            Ok(())
        } else {
            Err(CheckpointError::OtherConfiguration)
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CheckpointError> {
        let (array, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(CheckpointError::Damaged)?;
        self.rest = rest;
        Ok(*array)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, CheckpointError> {
        self.array().map(|[byte]| byte)
    }

    pub(crate) fn u32(&mut self) -> Result<u32, CheckpointError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Result<u64, CheckpointError> {
        self.array().map(u64::from_le_bytes)
    }

    /// Reads how often something was done: less than anything is ever done.
    pub(crate) fn count(&mut self) -> Result<u64, CheckpointError> {
        match self.u64()? {
            count if count < 1 << 39 => Ok(count),
            _ => Err(CheckpointError::Invalid("a count")),
        }
    }

    pub(crate) fn raw(&mut self, length: usize) -> Result<&'a [u8], CheckpointError> {
        let (bytes, rest) = self
            .rest
            .split_at_checked(length)
            .ok_or(CheckpointError::Damaged)?;
        self.rest = rest;
        Ok(bytes)
    }

    /// Reads so many finite numbers.
    pub(crate) fn f32s(
        &mut self,
        out: &mut [f32],
        what: &'static str,
    ) -> Result<(), CheckpointError> {
        let bytes = self.raw(out.len().saturating_mul(4))?;
        for (value, bytes) in out.iter_mut().zip(bytes.chunks_exact(4)) {
            *value = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        }
        if out.iter().all(|value| value.is_finite()) {
            Ok(())
        } else {
            Err(CheckpointError::Invalid(what))
        }
    }

    pub(crate) fn progress(&mut self) -> Result<Progress, CheckpointError> {
        let begun = self.u32()?;
        let length = usize::try_from(self.u64()?).map_err(|_| CheckpointError::Damaged)?;
        let taken = self.raw(length)?.to_vec();
        Ok(Progress { begun, taken })
    }

    /// Bytes that are left.
    pub(crate) const fn left(&self) -> usize {
        self.rest.len()
    }

    /// Checks that nothing is left.
    pub(crate) fn finish(self) -> Result<(), CheckpointError> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(CheckpointError::Damaged)
        }
    }
}
