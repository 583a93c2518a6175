//! The last sector of a slot: an append-only journal of what became of the image before it.
//!
//! | bytes | what |
//! |---|---|
//! | 0..4 | [`MAGIC`] |
//! | 4..8 | length of the envelope, and its complement, 16 bits each |
//! | 8..12 | CRC-32 of the envelope |
//! | 12..1036 | the envelope: opaque bytes, at most [`ENVELOPE_MAX`] |
//! | 1036..4096 | records, a word each: code, value, complement of the code, complement of the value |
//!
//! Every word is programmed once. Whatever the sector holds, scanning it gives a state: a record that was
//! torn is not its own complement any more, since bits only fall when programming and only rise when
//! erasing, and is left out; without an envelope that fits its CRC there are no records.
//!
//! Erase the trailer before the image: while it still tells of the image, that one is untouched.

mod scan;
mod store;

use crate::crc::crc32_le;
use crate::flash::{Chunk, Operation, SECTOR, WORD};
use crate::reason::RollbackReason;
use crate::trial::Sensors;

pub use scan::Scanner;

/// Longest envelope in bytes.
pub const ENVELOPE_MAX: usize = 1_024;
/// Where the envelope begins, in bytes from the start of the trailer.
pub const ENVELOPE_AT: u32 = 12;
/// How many blocks of an image can be told apart.
pub const BLOCKS_MAX: usize = 256;
/// First word of a trailer, `TCT1`.
pub const MAGIC: u32 = u32::from_le_bytes(*b"TCT1");

const RECORDS_AT: usize = ENVELOPE_AT as usize + ENVELOPE_MAX;

/// What a trailer is told, one word each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Record {
    /// This block of the image is in flash and matches its hash.
    Block(u8),
    /// The whole image is in flash and matches its hash. With the sensors that work before the update.
    Staged(Sensors),
    /// The image is about to be tried.
    Activated,
    /// The image was tried and has proven itself.
    Confirmed,
    /// The image was given up.
    RolledBack(RollbackReason),
}

impl Record {
    const fn word(self) -> u32 {
        let (code, value) = match self {
            Self::Block(index) => (0xB1, index),
            Self::Staged(sensors) => (0x57, sensors.bits()),
            Self::Activated => (0xAC, 0),
            Self::Confirmed => (0xC0, 0),
            Self::RolledBack(reason) => (0x2B, reason.number()),
        };
        u32::from_le_bytes([code, value, !code, !value])
    }

    /// The record of a word; `None` for one that was torn, that is free, or that a later program wrote.
    fn from_word(word: u32) -> Option<Self> {
        let [code, value, not_code, not_value] = word.to_le_bytes();
        if code != !not_code || value != !not_value {
            return None;
        }
        Some(match code {
            0xB1 => Self::Block(value),
            0x57 => Self::Staged(Sensors::from_bits(value)),
            0xAC => Self::Activated,
            0xC0 => Self::Confirmed,
            0x2B => Self::RolledBack(RollbackReason::from_number(value)?),
            _ => return None,
        })
    }
}

/// What became of an image that was tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It is being tried, or is about to be.
    Activated,
    /// It has proven itself.
    Confirmed,
    /// It was given up.
    RolledBack(RollbackReason),
}

/// What a trailer says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trailer {
    envelope: Option<u16>,
    blocks: [u32; BLOCKS_MAX / 32],
    staged: Option<Sensors>,
    outcome: Option<Outcome>,
    /// Where the next record goes.
    free: usize,
}

/// There is nothing to append to: no envelope, or no word left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrailerFull;

/// The envelope is empty, or longer than [`ENVELOPE_MAX`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EnvelopeSize;

impl Trailer {
    /// A sector without an envelope.
    pub const EMPTY: Self = Self {
        envelope: None,
        blocks: [0; BLOCKS_MAX / 32],
        staged: None,
        outcome: None,
        free: RECORDS_AT,
    };

    /// What these bytes of a trailer say, of which those beyond a sector do not count.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        let mut scanner = Scanner::new();
        scanner.feed(bytes);
        scanner.finish()
    }

    /// Length of the envelope in bytes, which begins at [`ENVELOPE_AT`]; `None` without one.
    #[must_use]
    pub const fn envelope(&self) -> Option<u16> {
        self.envelope
    }

    /// Whether this block is in flash.
    #[must_use]
    pub fn has_block(&self, index: u8) -> bool {
        let word = self.blocks.get(usize::from(index) / 32);
        word.is_some_and(|word| word >> (index % 32) & 1 == 1)
    }

    /// How many blocks are in flash.
    #[must_use]
    pub fn blocks(&self) -> u32 {
        self.blocks.iter().map(|word| word.count_ones()).sum()
    }

    /// The sensors that worked before the update, once the whole image is in flash.
    #[must_use]
    pub const fn staged(&self) -> Option<Sensors> {
        self.staged
    }

    /// What became of the image, since it was activated the last time.
    #[must_use]
    pub const fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }

    /// Why the image was given up, if it was.
    #[must_use]
    pub const fn rolled_back(&self) -> Option<RollbackReason> {
        match self.outcome {
            Some(Outcome::RolledBack(reason)) => Some(reason),
            _ => None,
        }
    }

    /// Whether it says so already.
    #[must_use]
    pub fn says(&self, record: Record) -> bool {
        match record {
            Record::Block(index) => self.has_block(index),
            Record::Staged(sensors) => self.staged == Some(sensors),
            Record::Activated => self.outcome == Some(Outcome::Activated),
            Record::Confirmed => self.outcome == Some(Outcome::Confirmed),
            Record::RolledBack(reason) => self.outcome == Some(Outcome::RolledBack(reason)),
        }
    }

    /// The operation that appends `record`; `None` when it [says](Self::says) so already.
    ///
    /// # Errors
    /// [`TrailerFull`].
    pub fn append(&self, record: Record) -> Result<Option<Operation>, TrailerFull> {
        if self.says(record) {
            return Ok(None);
        }
        if self.envelope.is_none() || self.free >= SECTOR as usize {
            return Err(TrailerFull);
        }
        Ok(Some(Operation::word(self.free as u32, record.word())))
    }

    fn take(&mut self, record: Record) {
        match record {
            Record::Block(index) => {
                if let Some(word) = self.blocks.get_mut(usize::from(index) / 32) {
                    *word |= 1 << (index % 32);
                }
            }
            Record::Staged(sensors) => self.staged = Some(sensors),
            Record::Activated => self.outcome = Some(Outcome::Activated),
            Record::Confirmed => self.outcome = Some(Outcome::Confirmed),
            Record::RolledBack(reason) => self.outcome = Some(Outcome::RolledBack(reason)),
        }
    }
}

/// The operations that begin a trailer anew: an erase, the envelope, and last what makes it count.
#[derive(Debug, Clone)]
pub struct Begin<'a> {
    envelope: &'a [u8],
    step: Step,
}

#[derive(Debug, Clone, Copy)]
enum Step {
    Erase,
    Envelope(usize),
    Done,
}

impl<'a> Begin<'a> {
    /// Begins a trailer with this envelope.
    ///
    /// # Errors
    /// [`EnvelopeSize`].
    pub const fn new(envelope: &'a [u8]) -> Result<Self, EnvelopeSize> {
        if envelope.is_empty() || envelope.len() > ENVELOPE_MAX {
            return Err(EnvelopeSize);
        }
        Ok(Self {
            envelope,
            step: Step::Erase,
        })
    }
}

impl Iterator for Begin<'_> {
    type Item = Operation;

    fn next(&mut self) -> Option<Operation> {
        match self.step {
            Step::Erase => {
                self.step = Step::Envelope(0);
                Some(Operation::Erase { at: 0 })
            }
            Step::Envelope(done) => {
                let rest = self.envelope.get(done..).unwrap_or(&[]);
                if rest.is_empty() {
                    self.step = Step::Done;
                    return Some(head(self.envelope));
                }
                self.step = Step::Envelope(done + Chunk::MAX);
                Some(Operation::Program {
                    at: ENVELOPE_AT + done as u32,
                    bytes: Chunk::of(rest),
                })
            }
            Step::Done => None,
        }
    }
}

/// The three words before the envelope.
fn head(envelope: &[u8]) -> Operation {
    let mut head = [0; ENVELOPE_AT as usize];
    let words = [
        MAGIC,
        length_word(envelope.len() as u16),
        crc32_le(0, envelope),
    ];
    for (bytes, word) in head.chunks_exact_mut(WORD).zip(words) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    Operation::Program {
        at: 0,
        bytes: Chunk::of(&head),
    }
}

const fn length_word(length: u16) -> u32 {
    length as u32 | (!length as u32) << 16
}
