//! What a coordinator keeps between rounds, as bytes.
//!
//! ```text
//! "TCFC"  version u8  taken u64  doubled u64  late u64  refused u64  samples u64  announcement  step f32 × weights  SHA-256 of all of that [32]
//! ```
//!
//! The announcement has round, plan and weights. Settings are handed in: they are the caller's to keep.

use std::error::Error;
use std::fmt;
use std::time::Duration;

use sha2::{Digest, Sha256};

use crate::coordinator::{Coordinator, Counts, Settings, SettingsError};
use crate::message::{Announcement, MessageError, Reader};

const MAGIC: [u8; 4] = *b"TCFC";
const VERSION: u8 = 1;
const HASH: usize = 32;

/// Why bytes cannot be gone on from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CheckpointError {
    /// They are something else.
    Foreign,
    /// Written by another version of this program.
    Version(u8),
    /// Cut off, or changed since they were written.
    Damaged,
    /// Of a run of other settings.
    OtherSettings,
    /// The settings are those of no run.
    Settings(SettingsError),
}

impl fmt::Display for CheckpointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Foreign => f.write_str("not a checkpoint of federated learning"),
            Self::Version(version) => write!(f, "version {version}; this program reads {VERSION}"),
            Self::Damaged => f.write_str("damaged: the checksum is another"),
            Self::OtherSettings => f.write_str("of a run of other settings"),
            Self::Settings(error) => error.fmt(f),
        }
    }
}

impl Error for CheckpointError {}

impl From<MessageError> for CheckpointError {
    fn from(_: MessageError) -> Self {
        Self::Damaged
    }
}

impl Coordinator {
    /// All that the run needs to go on after the last round that is over. Answers to the one under way are not in it: nodes send them
    /// again.
    #[must_use]
    pub fn checkpoint(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.push(VERSION);
        let Counts {
            taken,
            doubled,
            late,
            refused,
            samples,
        } = self.counts();
        for count in [taken, doubled, late, refused, samples] {
            bytes.extend_from_slice(&count.to_le_bytes());
        }
        bytes.extend_from_slice(&self.announcement());
        for number in self.last_step() {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        let hash = Sha256::digest(&bytes);
        bytes.extend_from_slice(&hash);
        bytes
    }

    /// Goes on with a run at `now`: its announcement is the one that it was, byte for byte.
    ///
    /// # Errors
    /// When the bytes are no checkpoint of a run of these settings.
    pub fn resume(
        settings: Settings,
        bytes: &[u8],
        now: Duration,
    ) -> Result<Self, CheckpointError> {
        settings.validate().map_err(CheckpointError::Settings)?;
        let mut reader = Reader(bytes);
        if reader.array() != Ok(MAGIC) {
            return Err(CheckpointError::Foreign);
        }
        match reader.u8()? {
            VERSION => {}
            version => return Err(CheckpointError::Version(version)),
        }
        let (content, hash) = bytes
            .split_last_chunk::<HASH>()
            .ok_or(CheckpointError::Damaged)?;
        if Sha256::digest(content).as_slice() != hash {
            return Err(CheckpointError::Damaged);
        }
        let counts = Counts {
            taken: reader.u64()?,
            doubled: reader.u64()?,
            late: reader.u64()?,
            refused: reader.u64()?,
            samples: reader.u64()?,
        };
        let rest = reader
            .0
            .len()
            .checked_sub(HASH)
            .ok_or(CheckpointError::Damaged)?;
        let (announced, mut steps) = Announcement::from_front(reader.take(rest)?)?;
        let mut step = Vec::with_capacity(announced.weights.len());
        for _ in 0..announced.weights.len() {
            step.push(steps.f32("step")?);
        }
        steps.end()?;
        let deadline_ms = settings.deadline.as_millis();
        let own = announced.plan == settings.plan
            && announced.rounds == settings.rounds
            && u128::from(announced.deadline_ms) == deadline_ms;
        if !own {
            return Err(CheckpointError::OtherSettings);
        }
        Ok(Self::of(
            settings,
            announced.round,
            announced.weights,
            step,
            counts,
            now,
        ))
    }
}
