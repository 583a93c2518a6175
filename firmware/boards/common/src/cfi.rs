//! Flash chips with the common flash interface and the basic command set, as a region for
//! parameters.
//!
//! Two chips of 16 bits side by side make one word of 32; commands and status go to both at once.
//! Commands and status bits: Intel 28F128J3 data sheet, tables "Command Bus-Cycle
//! Definitions" and "Status Register Definitions"; query: JEDEC JESD68.01.
//!
//! Words are written once after each erasure and not again, though the chips would clear further
//! bits: a program that relied on that would fail on flash with error correction.

use crawler_hal::{Clock, Duration};
use embassy_futures::yield_now;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

#[cfg(test)]
mod tests;

/// Bytes that are erased together: 128 KiB in each of the two chips.
pub const ERASE_BLOCK: u32 = 256 * 1024;
/// Bytes that are written together.
pub const WORD: u32 = 4;

/// Longest time to write a word (data sheet: 630 µs at most), with a wide margin for an emulator
/// that is itself held up.
pub const WRITTEN_WITHIN: Duration = Duration::from_millis(50);
/// Longest time to erase a block (data sheet: 5 s at most; an emulator takes milliseconds). Less
/// than the program waits for its flash, so that it hears why.
pub const ERASED_WITHIN: Duration = Duration::from_millis(1_000);
/// Looks at the status before the wait becomes a sleep.
const QUICK_LOOKS: u32 = 64;
/// Time between two looks after that.
const LOOK_EVERY: Duration = Duration::from_micros(500);

const READ_ARRAY: u32 = both(0xFF);
const QUERY: u32 = both(0x98);
const READ_STATUS: u32 = both(0x70);
const CLEAR_STATUS: u32 = both(0x50);
const PROGRAM: u32 = both(0x40);
const ERASE: u32 = both(0x20);
const CONFIRM: u32 = both(0xD0);

/// Both chips are done.
const READY: u32 = both(0x80);
/// Either chip reports: erasure failed, writing failed, no programming voltage, block locked.
const FAILED: u32 = both(0x3A);

/// Where the query command goes, and what the chips then tell, in words.
const QUERY_AT: u32 = 0x55 * WORD;
const IDENTITY: u32 = 0x10;
const SIZE: u32 = 0x27;
const ERASE_REGIONS: u32 = 0x2C;
const BLOCK_SIZE_LOW: u32 = 0x2F;
const BLOCK_SIZE_HIGH: u32 = 0x30;

const ERASED: u32 = u32::MAX;

const fn both(command: u32) -> u32 {
    command << 16 | command
}

/// The bus between the controller and the chips. Offsets are in bytes, multiples of [`WORD`].
pub trait Bus {
    /// Reads a word.
    fn read(&self, offset: u32) -> u32;
    /// Writes a word: a command, or data after one.
    fn write(&mut self, offset: u32, word: u32);
}

/// Why the flash did not do what it was told. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CfiError {
    /// Nothing answers as such a chip does: wiring, or the emulator's command line.
    Absent,
    /// The chips are others than this driver was made for.
    Geometry,
    /// Not on a boundary of words or blocks: a mistake of the caller.
    Misaligned,
    /// Beyond the region: a mistake of the caller.
    OutOfBounds,
    /// A word that was written since its block was last erased: a mistake of the caller.
    NotErased,
    /// The chips say that they failed, with their status: worn, locked, or without voltage.
    Refused(u32),
    /// The chips do not get done.
    Stuck,
    /// What was written does not read back: worn.
    Differs,
}

impl core::fmt::Display for CfiError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Absent => f.write_str("no flash chip answers"),
            Self::Geometry => f.write_str("the flash chips have another geometry"),
            Self::Misaligned => f.write_str("not on a boundary of the flash"),
            Self::OutOfBounds => f.write_str("beyond the flash region"),
            Self::NotErased => f.write_str("the word was written before"),
            Self::Refused(status) => write!(f, "the flash refused with status {status:#x}"),
            Self::Stuck => f.write_str("the flash does not get done"),
            Self::Differs => f.write_str("the flash keeps something else"),
        }
    }
}

impl core::error::Error for CfiError {}

impl NorFlashError for CfiError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Misaligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// The first blocks of a pair of chips. Address 0 of the region is that of the chips.
#[derive(Debug)]
pub struct CfiFlash<B, C> {
    bus: B,
    clock: C,
    len: u32,
}

impl<B: Bus, C: Clock> CfiFlash<B, C> {
    /// The first `blocks` erase blocks. Does no I/O: [`Self::probe`] does.
    pub const fn new(bus: B, clock: C, blocks: u16) -> Self {
        Self {
            bus,
            clock,
            len: blocks as u32 * ERASE_BLOCK,
        }
    }

    /// Asks the chips what they are, and leaves them readable.
    ///
    /// # Errors
    /// [`CfiError::Absent`] or [`CfiError::Geometry`].
    pub fn probe(&mut self) -> Result<(), CfiError> {
        self.bus.write(0, READ_ARRAY);
        self.bus.write(QUERY_AT, QUERY);
        let told = |index: u32| self.bus.read(index * WORD);
        let identity = (0..3).map(|i| told(IDENTITY + i));
        let present = identity.eq("QRY".bytes().map(|letter| both(letter.into())));
        let size = 1_u64.checked_shl(told(SIZE) & 0xFF).unwrap_or(0) * 2;
        let block = ((told(BLOCK_SIZE_HIGH) & 0xFF) << 16 | (told(BLOCK_SIZE_LOW) & 0xFF) << 8) * 2;
        let regions = told(ERASE_REGIONS) & 0xFF;
        self.bus.write(0, READ_ARRAY);
        if !present {
            return Err(CfiError::Absent);
        }
        if regions != 1 || block != ERASE_BLOCK || size < u64::from(self.len) {
            return Err(CfiError::Geometry);
        }
        Ok(())
    }

    fn check(&self, offset: u32, len: usize, unit: u32) -> Result<u32, CfiError> {
        let len = u32::try_from(len).map_err(|_| CfiError::OutOfBounds)?;
        let end = offset.checked_add(len).ok_or(CfiError::OutOfBounds)?;
        if end > self.len {
            return Err(CfiError::OutOfBounds);
        }
        if !offset.is_multiple_of(unit) || !len.is_multiple_of(unit) {
            return Err(CfiError::Misaligned);
        }
        Ok(end)
    }

    /// Runs one command and leaves the chips readable, whatever came of it.
    async fn command(
        &mut self,
        offset: u32,
        command: u32,
        data: u32,
        within: Duration,
    ) -> Result<(), CfiError> {
        self.bus.write(offset, CLEAR_STATUS);
        self.bus.write(offset, command);
        self.bus.write(offset, data);
        let outcome = self.settle(offset, within).await;
        self.bus.write(offset, CLEAR_STATUS);
        self.bus.write(offset, READ_ARRAY);
        outcome
    }

    async fn settle(&mut self, offset: u32, within: Duration) -> Result<(), CfiError> {
        let deadline = self.clock.now() + within;
        let mut looks = 0;
        loop {
            self.bus.write(offset, READ_STATUS);
            let status = self.bus.read(offset);
            if status & READY == READY {
                return match status & FAILED {
                    0 => Ok(()),
                    _ => Err(CfiError::Refused(status)),
                };
            }
            looks += 1;
            if looks > QUICK_LOOKS {
                if self.clock.now() >= deadline {
                    return Err(CfiError::Stuck);
                }
                self.clock.sleep(LOOK_EVERY).await;
            }
        }
    }
}

impl<B: Bus, C: Clock> ErrorType for CfiFlash<B, C> {
    type Error = CfiError;
}

impl<B: Bus, C: Clock> ReadNorFlash for CfiFlash<B, C> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), CfiError> {
        self.check(offset, bytes.len(), 1)?;
        for (at, byte) in (offset..).zip(bytes) {
            let word = self.bus.read(at / WORD * WORD);
            *byte = word.to_le_bytes()[(at % WORD) as usize];
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.len as usize
    }
}

impl<B: Bus, C: Clock> NorFlash for CfiFlash<B, C> {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = ERASE_BLOCK as usize;

    /// # Cancellation Safety
    /// As safe as a power cut; the next command finds the chips as they are.
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), CfiError> {
        let len = to.checked_sub(from).ok_or(CfiError::OutOfBounds)?;
        self.check(from, len as usize, ERASE_BLOCK)?;
        for block in (from..to).step_by(ERASE_BLOCK as usize) {
            self.command(block, ERASE, CONFIRM, ERASED_WITHIN).await?;
            yield_now().await;
        }
        Ok(())
    }

    /// # Cancellation Safety
    /// As safe as a power cut; the next command finds the chips as they are.
    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), CfiError> {
        self.check(offset, bytes.len(), WORD)?;
        let words = bytes.as_chunks::<4>().0.iter();
        for (at, word) in (offset..).step_by(WORD as usize).zip(words) {
            let word = u32::from_le_bytes(*word);
            if self.bus.read(at) != ERASED {
                return Err(CfiError::NotErased);
            }
            if word == ERASED {
                continue;
            }
            self.command(at, PROGRAM, word, WRITTEN_WITHIN).await?;
            if self.bus.read(at) != word {
                return Err(CfiError::Differs);
            }
            // A word takes an emulator milliseconds of its host; others have waited for it.
            yield_now().await;
        }
        Ok(())
    }
}
