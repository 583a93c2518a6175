//! Flash chips with the common flash interface and the basic command set, as regions for parameters and
//! for programs.
//!
//! [`Chips`] knows the commands. Regions share them behind a lock, which is held for one command alone: a
//! block that is erased, or a buffer that is written. While a command runs nothing else can be read from
//! the chips.
//!
//! Two chips of 16 bits side by side make one word of 32; commands and status go to both at once.
//! Commands and status bits: Intel 28F128J3 data sheet, tables "Command Bus-Cycle
//! Definitions" and "Status Register Definitions"; query: JEDEC JESD68.01.
//!
//! In a [`CfiFlash`] words are written once after each erasure and not again, though the chips would clear
//! further bits: a program that relied on that would fail on flash with error correction. [`SlotFlash`]
//! clears further bits, as select entries and journals want it.

mod slots;

use crawler_hal::{Clock, Duration};
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::mutex::Mutex;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

pub use slots::SlotFlash;

#[cfg(test)]
mod tests;

/// Bytes that are erased together: 128 KiB in each of the two chips.
pub const ERASE_BLOCK: u32 = 256 * 1024;
/// Bytes that are written together.
pub const WORD: u32 = 4;

/// Most bytes that are written with one command: what the buffers of both chips hold, where theirs are large. An
/// emulator does that in less time than a word takes it twice.
pub const BUFFER: u32 = 2 * 1024;

/// Longest time to write a word (data sheet: 630 µs at most) or a buffer, with a wide margin for an emulator
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
const WRITE_BUFFER: u32 = both(0xE8);
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
const BUFFER_SIZE: u32 = 0x2A;
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
    /// A sector that cannot be erased without others: a mistake of the caller.
    Shared,
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
            Self::Shared => f.write_str("other sectors would be erased as well"),
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

/// A pair of chips.
#[derive(Debug)]
pub struct Chips<B, C> {
    bus: B,
    clock: C,
    /// Bytes that are written with one command: a word until [`Self::probe`] has asked.
    buffer: u32,
    /// Where a command was given whose end nobody has seen.
    pending: Option<u32>,
}

/// Chips that several regions share.
pub type SharedChips<M, B, C> = Mutex<M, Chips<B, C>>;

/// What may be written where something was written before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// Nothing.
    Once,
    /// What clears bits.
    ClearBits,
}

impl<B: Bus, C: Clock> Chips<B, C> {
    /// The chips on this bus. Does no I/O: [`Self::probe`] does.
    pub const fn new(bus: B, clock: C) -> Self {
        Self {
            bus,
            clock,
            buffer: WORD,
            pending: None,
        }
    }

    /// Asks the chips what they are, and leaves them readable. From then on whole buffers are written.
    ///
    /// # Errors
    /// [`CfiError::Absent`] or [`CfiError::Geometry`], which leave writing word by word.
    pub fn probe(&mut self, bytes: u32) -> Result<(), CfiError> {
        self.bus.write(0, READ_ARRAY);
        self.bus.write(QUERY_AT, QUERY);
        let told = |index: u32| self.bus.read(index * WORD);
        let identity = (0..3).map(|i| told(IDENTITY + i));
        let present = identity.eq("QRY".bytes().map(|letter| both(letter.into())));
        let size = 1_u64.checked_shl(told(SIZE) & 0xFF).unwrap_or(0) * 2;
        let block = ((told(BLOCK_SIZE_HIGH) & 0xFF) << 16 | (told(BLOCK_SIZE_LOW) & 0xFF) << 8) * 2;
        let regions = told(ERASE_REGIONS) & 0xFF;
        let buffer = 2_u32.checked_shl(told(BUFFER_SIZE) & 0xFF).unwrap_or(0);
        self.bus.write(0, READ_ARRAY);
        if !present {
            return Err(CfiError::Absent);
        }
        if regions != 1 || block != ERASE_BLOCK || size < u64::from(bytes) {
            return Err(CfiError::Geometry);
        }
        // Chips without a buffer say 1.
        self.buffer = if buffer < 2 * WORD {
            WORD
        } else {
            buffer.min(BUFFER)
        };
        Ok(())
    }

    /// Lets a command end that was given up by whoever gave it, before anything else is done.
    async fn recover(&mut self) -> Result<(), CfiError> {
        let Some(offset) = self.pending else {
            return Ok(());
        };
        let _ = self.settle(offset, ERASED_WITHIN).await;
        self.finish(offset);
        Ok(())
    }

    fn finish(&mut self, offset: u32) {
        self.bus.write(offset, CLEAR_STATUS);
        self.bus.write(offset, READ_ARRAY);
        self.pending = None;
    }

    /// Waits for the end of a command and leaves the chips readable, whatever came of it.
    async fn conclude(&mut self, offset: u32, within: Duration) -> Result<(), CfiError> {
        let outcome = self.settle(offset, within).await;
        self.finish(offset);
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

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), CfiError> {
        self.recover().await?;
        for (at, byte) in (offset..).zip(bytes) {
            let word = self.bus.read(at / WORD * WORD);
            *byte = word.to_le_bytes()[(at % WORD) as usize];
        }
        Ok(())
    }

    /// Whether `length` bytes from `offset` on are erased; both are whole words.
    async fn is_blank(&mut self, offset: u32, length: u32) -> Result<bool, CfiError> {
        self.recover().await?;
        let mut words = (offset..offset + length).step_by(WORD as usize);
        Ok(words.all(|at| self.bus.read(at) == ERASED))
    }

    /// Erases the block that begins at `block`.
    async fn erase_block(&mut self, block: u32) -> Result<(), CfiError> {
        self.recover().await?;
        self.bus.write(block, CLEAR_STATUS);
        self.pending = Some(block);
        self.bus.write(block, ERASE);
        self.bus.write(block, CONFIRM);
        self.conclude(block, ERASED_WITHIN).await
    }

    /// How many of `length` bytes from `offset` on are written with one command.
    const fn slice(&self, offset: u32, length: usize) -> usize {
        let room = (self.buffer - offset % self.buffer) as usize;
        if length < room { length } else { room }
    }

    /// Writes words that one command takes ([`Self::slice`]).
    async fn program(&mut self, offset: u32, bytes: &[u8], rule: Rule) -> Result<(), CfiError> {
        self.recover().await?;
        let words = || {
            let words = bytes.as_chunks::<4>().0.iter();
            let values = words.map(|word| u32::from_le_bytes(*word));
            (offset..).step_by(WORD as usize).zip(values)
        };
        if rule == Rule::Once && words().any(|(at, _)| self.bus.read(at) != ERASED) {
            return Err(CfiError::NotErased);
        }
        if words().all(|(at, word)| self.bus.read(at) & word == self.bus.read(at)) {
            return Ok(());
        }
        // A buffer is written as it is, so it must not say 1 where a bit was cleared before.
        let plain = words().all(|(at, word)| self.bus.read(at) & word == word);
        if plain && bytes.len() > WORD as usize {
            self.fill_buffer(offset, words())?;
            self.conclude(offset, WRITTEN_WITHIN).await?;
            let kept = words().all(|(at, word)| self.bus.read(at) == word);
            return if kept { Ok(()) } else { Err(CfiError::Differs) };
        }
        for (at, word) in words() {
            let present = self.bus.read(at);
            let word = present & word;
            if word == present {
                continue;
            }
            self.bus.write(at, CLEAR_STATUS);
            self.pending = Some(at);
            self.bus.write(at, PROGRAM);
            self.bus.write(at, word);
            self.conclude(at, WRITTEN_WITHIN).await?;
            if self.bus.read(at) != word {
                return Err(CfiError::Differs);
            }
        }
        Ok(())
    }

    /// Gives the command that writes a buffer. Nothing is awaited in between: chips that wait for words take a
    /// question for one.
    fn fill_buffer(
        &mut self,
        offset: u32,
        words: impl Iterator<Item = (u32, u32)> + Clone,
    ) -> Result<(), CfiError> {
        self.bus.write(offset, CLEAR_STATUS);
        let available = (0..QUICK_LOOKS).any(|_| {
            self.bus.write(offset, WRITE_BUFFER);
            self.bus.read(offset) & READY == READY
        });
        if !available {
            self.finish(offset);
            return Err(CfiError::Stuck);
        }
        self.pending = Some(offset);
        self.bus
            .write(offset, both(words.clone().count() as u32 - 1));
        for (at, word) in words {
            self.bus.write(at, word);
        }
        self.bus.write(offset, CONFIRM);
        Ok(())
    }
}

fn check(capacity: u32, offset: u32, len: usize, unit: u32) -> Result<u32, CfiError> {
    let len = u32::try_from(len).map_err(|_| CfiError::OutOfBounds)?;
    let end = offset.checked_add(len).ok_or(CfiError::OutOfBounds)?;
    if end > capacity {
        return Err(CfiError::OutOfBounds);
    }
    if !offset.is_multiple_of(unit) || !len.is_multiple_of(unit) {
        return Err(CfiError::Misaligned);
    }
    Ok(end)
}

/// Some blocks of the chips. Address 0 of the region is the start of the first one.
#[derive(Debug)]
pub struct CfiFlash<'a, M: RawMutex, B, C> {
    chips: &'a SharedChips<M, B, C>,
    start: u32,
    len: u32,
}

impl<'a, M: RawMutex, B: Bus, C: Clock> CfiFlash<'a, M, B, C> {
    /// `blocks` erase blocks from the one with the number `first` on. Does no I/O: [`Self::probe`] does.
    pub const fn new(chips: &'a SharedChips<M, B, C>, first: u16, blocks: u16) -> Self {
        Self {
            chips,
            start: first as u32 * ERASE_BLOCK,
            len: blocks as u32 * ERASE_BLOCK,
        }
    }

    /// Asks the chips what they are, and leaves them readable.
    ///
    /// # Errors
    /// [`CfiError::Absent`] or [`CfiError::Geometry`].
    pub async fn probe(&mut self) -> Result<(), CfiError> {
        self.chips.lock().await.probe(self.start + self.len)
    }
}

impl<M: RawMutex, B: Bus, C: Clock> ErrorType for CfiFlash<'_, M, B, C> {
    type Error = CfiError;
}

impl<M: RawMutex, B: Bus, C: Clock> ReadNorFlash for CfiFlash<'_, M, B, C> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), CfiError> {
        check(self.len, offset, bytes.len(), 1)?;
        let mut chips = self.chips.lock().await;
        chips.read(self.start + offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.len as usize
    }
}

impl<M: RawMutex, B: Bus, C: Clock> NorFlash for CfiFlash<'_, M, B, C> {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = ERASE_BLOCK as usize;

    /// # Cancellation Safety
    /// As safe as a power cut; the next command finds the chips as they are.
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), CfiError> {
        let len = to.checked_sub(from).ok_or(CfiError::OutOfBounds)?;
        check(self.len, from, len as usize, ERASE_BLOCK)?;
        for block in (from..to).step_by(ERASE_BLOCK as usize) {
            let block = self.start + block;
            self.chips.lock().await.erase_block(block).await?;
            yield_now().await;
        }
        Ok(())
    }

    /// # Cancellation Safety
    /// As safe as a power cut; the next command finds the chips as they are.
    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), CfiError> {
        check(self.len, offset, bytes.len(), WORD)?;
        write_slices(self.chips, self.start + offset, bytes, Rule::Once).await
    }
}

/// Writes `bytes`, with one command after the other.
async fn write_slices<M: RawMutex, B: Bus, C: Clock>(
    chips: &SharedChips<M, B, C>,
    mut offset: u32,
    mut bytes: &[u8],
    rule: Rule,
) -> Result<(), CfiError> {
    while !bytes.is_empty() {
        let mut chips = chips.lock().await;
        let (slice, rest) = bytes.split_at(chips.slice(offset, bytes.len()));
        chips.program(offset, slice, rule).await?;
        drop(chips);
        offset += slice.len() as u32;
        bytes = rest;
        // A command takes an emulator up to milliseconds of its host; others have waited for it.
        yield_now().await;
    }
    Ok(())
}
