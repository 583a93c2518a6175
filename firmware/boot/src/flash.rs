//! What is to be done to the flash next, and doing it.

use embedded_storage::nor_flash::MultiwriteNorFlash;
use embedded_storage_async::nor_flash::MultiwriteNorFlash as AsyncMultiwriteNorFlash;

/// Bytes of an erase block.
pub const SECTOR: u32 = 4_096;
/// Bytes of a word: programming happens in whole words.
pub const WORD: usize = 4;

/// Some words to program, at most [`Chunk::MAX`] bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    bytes: [u8; Self::MAX],
    length: u8,
}

impl Chunk {
    /// Longest chunk in bytes.
    pub const MAX: usize = 32;

    /// The first [`Chunk::MAX`] bytes of `bytes`, filled up to whole words with `0xFF`, which programs
    /// nothing.
    pub(crate) fn of(bytes: &[u8]) -> Self {
        let mut chunk = Self {
            bytes: [0xFF; Self::MAX],
            length: bytes.len().min(Self::MAX).next_multiple_of(WORD) as u8,
        };
        for (kept, byte) in chunk.bytes.iter_mut().zip(bytes) {
            *kept = *byte;
        }
        chunk
    }

    /// The bytes: whole words.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.length)).unwrap_or(&[])
    }
}

/// One thing to do to the flash. Addresses count from the start of the region that was looked at: the
/// otadata partition, or the last sector of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// Erase the sector that begins at `at`.
    Erase {
        /// Its address in bytes.
        at: u32,
    },
    /// Program `bytes` from `at` on. It never asks for a bit that is 0 to become 1.
    Program {
        /// The address in bytes, a multiple of [`WORD`].
        at: u32,
        /// What to program.
        bytes: Chunk,
    },
}

impl Operation {
    pub(crate) fn word(at: u32, word: u32) -> Self {
        Self::Program {
            at,
            bytes: Chunk::of(&word.to_le_bytes()),
        }
    }

    /// Does it, in a region that begins at `base` of `flash`.
    ///
    /// A flash that programs more than a [`WORD`] at once, as one with flash encryption does (16 bytes,
    /// ESP-IDF programming guide, "Flash Encryption"), does not compile here: a word of it could not be
    /// programmed without those beside it.
    ///
    /// # Errors
    /// That of the flash.
    pub fn execute<F: MultiwriteNorFlash>(&self, flash: &mut F, base: u32) -> Result<(), F::Error> {
        const { assert!(WORD.is_multiple_of(F::WRITE_SIZE)) };
        const { assert!((SECTOR as usize).is_multiple_of(F::ERASE_SIZE)) };
        match self {
            Self::Erase { at } => flash.erase(base + at, base + at + SECTOR),
            Self::Program { at, bytes } => flash.write(base + at, bytes.as_bytes()),
        }
    }

    /// As [`Operation::execute`], where the flash is waited for.
    ///
    /// # Errors
    /// That of the flash.
    ///
    /// # Cancellation Safety
    /// A dropped call may have taken place in part, as after a power cut: look at the flash again.
    pub async fn execute_async<F: AsyncMultiwriteNorFlash>(
        &self,
        flash: &mut F,
        base: u32,
    ) -> Result<(), F::Error> {
        const { assert!(WORD.is_multiple_of(F::WRITE_SIZE)) };
        const { assert!((SECTOR as usize).is_multiple_of(F::ERASE_SIZE)) };
        match self {
            Self::Erase { at } => flash.erase(base + at, base + at + SECTOR).await,
            Self::Program { at, bytes } => flash.write(base + at, bytes.as_bytes()).await,
        }
    }
}

/// Why a goal was not reached. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlashError<E, R> {
    /// The flash said no: as the flash says.
    Flash(E),
    /// It must not be done now.
    Refused(R),
    /// The flash takes what it is told and does not keep it: it is worn.
    Worn,
}
