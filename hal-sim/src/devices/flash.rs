//! NOR flash that holds the caller to the rules and may lose its power at any byte.

use std::cell::RefCell;
use std::rc::Rc;

use crawler_hal::ResetCause;
use embedded_storage_async::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use rand_core::Rng;
use rand_pcg::Pcg32;

use super::ports::Wire;
use crate::world::{Purpose, stream};

/// Bytes of an erase block.
pub const ERASE_BYTES: usize = 4_096;
/// Bytes of a word: reads and writes are aligned to it, as on the ESP32.
pub const WRITE_BYTES: usize = 4;

/// Contents of an erased byte.
const BLANK: u8 = 0xFF;

/// Why a flash operation failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FlashError {
    /// An address or a length is not a multiple of what the operation needs.
    NotAligned,
    /// The range leaves the region, or ends before it begins.
    OutOfBounds,
    /// A bit that is 0 was to become 1 without an erase: the block was not erased first.
    NotErased,
    /// The power is gone, or this handle belongs to a program before the last reset.
    PowerLost,
}

impl core::fmt::Display for FlashError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotAligned => "not aligned",
            Self::OutOfBounds => "out of bounds",
            Self::NotErased => "written without erasing first",
            Self::PowerLost => "power lost",
        })
    }
}

impl core::error::Error for FlashError {}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::NotErased | Self::PowerLost => NorFlashErrorKind::Other,
        }
    }
}

#[derive(Debug, Clone, Default)]
struct Sector {
    /// What was written from the start of the sector on; the rest is blank. Stores that append,
    /// as they all do on flash, leave this short.
    written: Vec<u8>,
    erases: u32,
}

impl Sector {
    fn byte(&self, at: usize) -> u8 {
        self.written.get(at).copied().unwrap_or(BLANK)
    }

    fn set(&mut self, at: usize, byte: u8) {
        if at >= self.written.len() {
            if byte == BLANK {
                return;
            }
            self.written.resize(at + 1, BLANK);
        }
        self.written[at] = byte;
    }
}

/// What a chip holds when its power is off, and the cut that is planned.
#[cfg(feature = "live")]
#[derive(Debug, Clone, Default)]
pub(crate) struct Contents {
    sectors: Vec<Sector>,
    budget: Option<u64>,
}

#[cfg(feature = "live")]
impl Contents {
    /// Memory of the host that it takes, in bytes.
    pub(crate) fn footprint(&self) -> usize {
        let written = self.sectors.iter().map(|sector| sector.written.len());
        written.sum::<usize>() + self.sectors.len() * size_of::<Sector>()
    }
}

/// The memory itself, which outlives the programs that use it.
#[derive(Debug)]
pub struct Chip {
    sectors: Vec<Sector>,
    rng: Pcg32,
    powered: bool,
    /// Bytes that may still be written or erased before the power goes.
    budget: Option<u64>,
    /// Handles opened before the last power-up are disconnected.
    session: u32,
    violations: u32,
    bytes_written: u64,
}

impl Chip {
    pub(crate) fn new(sectors: usize, rng: Pcg32) -> Self {
        Self {
            sectors: vec![Sector::default(); sectors],
            rng,
            powered: true,
            budget: None,
            session: 0,
            violations: 0,
            bytes_written: 0,
        }
    }

    /// An erased chip of so many sectors of [`ERASE_BYTES`], outside of any world. What a torn
    /// write leaves behind is drawn from `seed`.
    pub fn blank(sectors: u16, seed: u64) -> Rc<RefCell<Self>> {
        let rng = stream(seed, 0, Purpose::Flash);
        Rc::new(RefCell::new(Self::new(usize::from(sectors), rng)))
    }

    /// What is written in each sector; the rest of it is blank.
    #[cfg(feature = "recording")]
    fn image(&self) -> Vec<Vec<u8>> {
        let sectors = self.sectors.iter();
        sectors.map(|sector| sector.written.clone()).collect()
    }

    /// A chip with these contents, outside of any world.
    #[cfg(feature = "recording")]
    pub(crate) fn of_image<'a>(image: impl ExactSizeIterator<Item = &'a [u8]>) -> Self {
        let mut chip = Self::new(image.len(), stream(0, 0, Purpose::Flash));
        for (sector, bytes) in chip.sectors.iter_mut().zip(image) {
            sector.written = bytes.to_vec();
            sector.written.truncate(ERASE_BYTES);
        }
        chip
    }

    /// What is in it.
    #[cfg(feature = "live")]
    pub(crate) fn contents(&self) -> Contents {
        Contents {
            sectors: self.sectors.clone(),
            budget: self.budget,
        }
    }

    /// Has these contents from now on, which are those of a chip of the same size.
    #[cfg(feature = "live")]
    pub(crate) fn fill(&mut self, contents: &Contents) {
        for (sector, kept) in self.sectors.iter_mut().zip(&contents.sectors) {
            sector.clone_from(kept);
        }
        self.budget = contents.budget;
    }

    /// Cuts the power once so many more bytes were written or erased; the byte at which it
    /// happens is left half done. `0` tears the very next one.
    pub fn cut_power_after(&mut self, bytes: u64) {
        self.budget = Some(bytes);
    }

    /// Replaces all that is in it by noise drawn from `seed`.
    pub fn fill_with_noise(&mut self, seed: u64) {
        let mut rng = stream(seed, 1, Purpose::Flash);
        for sector in &mut self.sectors {
            sector.written.resize(ERASE_BYTES, BLANK);
            rng.fill_bytes(&mut sector.written);
        }
    }

    /// Takes a planned cut back. Power that is gone stays gone.
    pub fn keep_power(&mut self) {
        self.budget = None;
    }

    /// Cuts the power between two operations.
    pub fn lose_power(&mut self) {
        self.powered = false;
    }

    /// Switches the power on again, with no cut planned. Handles opened before are disconnected.
    pub fn restore_power(&mut self) {
        self.powered = true;
        self.budget = None;
        self.session = self.session.wrapping_add(1);
    }

    /// Whether the power is on.
    pub const fn has_power(&self) -> bool {
        self.powered
    }

    /// How often a caller broke a rule: alignment, bounds, or erase before write.
    pub const fn violations(&self) -> u32 {
        self.violations
    }

    /// How often a sector was erased; `None` when there is no such sector.
    pub fn erases(&self, sector: usize) -> Option<u32> {
        self.sectors.get(sector).map(|sector| sector.erases)
    }

    /// Memory of the host that the contents take, in bytes: what was written, not the region.
    pub fn footprint(&self) -> usize {
        self.sectors.iter().map(|s| s.written.capacity()).sum()
    }

    /// Bytes written so far.
    pub const fn bytes_written(&self) -> u64 {
        self.bytes_written
    }

    fn capacity(&self) -> usize {
        self.sectors.len() * ERASE_BYTES
    }

    fn broken(&mut self, rule: FlashError) -> FlashError {
        self.violations = self.violations.saturating_add(1);
        rule
    }

    fn check(&mut self, from: u32, length: usize, unit: usize) -> Result<usize, FlashError> {
        let from = from as usize;
        if !from.is_multiple_of(unit) || !length.is_multiple_of(unit) {
            return Err(self.broken(FlashError::NotAligned));
        }
        if from
            .checked_add(length)
            .is_none_or(|end| end > self.capacity())
        {
            return Err(self.broken(FlashError::OutOfBounds));
        }
        Ok(from)
    }

    /// Takes one byte from the budget; false when the power goes at this byte.
    fn spend(&mut self) -> bool {
        match &mut self.budget {
            None => true,
            Some(0) => {
                self.budget = None;
                self.powered = false;
                false
            }
            Some(left) => {
                *left -= 1;
                true
            }
        }
    }

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let from = self.check(offset, bytes.len(), WRITE_BYTES)?;
        for (at, byte) in (from..).zip(bytes) {
            *byte = self.sectors[at / ERASE_BYTES].byte(at % ERASE_BYTES);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let from = self.check(offset, bytes.len(), WRITE_BYTES)?;
        let rises = |&(at, &new): &(usize, &u8)| {
            let old = self.sectors[at / ERASE_BYTES].byte(at % ERASE_BYTES);
            new & !old != 0
        };
        if (from..).zip(bytes).any(|pair| rises(&pair)) {
            return Err(self.broken(FlashError::NotErased));
        }
        for (at, &new) in (from..).zip(bytes) {
            let whole = self.spend();
            // Some of the bits that were to fall did.
            let left = if whole { 0 } else { self.rng.next_u32() as u8 };
            let sector = &mut self.sectors[at / ERASE_BYTES];
            let old = sector.byte(at % ERASE_BYTES);
            sector.set(at % ERASE_BYTES, old & (new | left));
            if !whole {
                return Err(FlashError::PowerLost);
            }
            self.bytes_written += 1;
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let Some(length) = to.checked_sub(from) else {
            return Err(self.broken(FlashError::OutOfBounds));
        };
        let from = self.check(from, length as usize, ERASE_BYTES)?;
        for index in from / ERASE_BYTES..(from + length as usize) / ERASE_BYTES {
            self.sectors[index].erases = self.sectors[index].erases.saturating_add(1);
            if self.budget.is_none_or(|left| left >= ERASE_BYTES as u64) {
                self.budget = self.budget.map(|left| left - ERASE_BYTES as u64);
                self.sectors[index].written = Vec::new();
                continue;
            }
            for at in 0..ERASE_BYTES {
                if self.powered && self.spend() {
                    self.sectors[index].set(at, BLANK);
                } else {
                    // All cells rise together; where it stopped, some bits have, some not.
                    let risen = self.rng.next_u32() as u8;
                    let old = self.sectors[index].byte(at);
                    self.sectors[index].set(at, old | risen);
                }
            }
            return Err(FlashError::PowerLost);
        }
        Ok(())
    }

    pub(crate) fn fingerprint(&self, mut word: impl FnMut(u64)) {
        word(self.rng.clone().next_u64());
        word(u64::from(self.powered) | u64::from(self.session) << 1);
        word(self.budget.map_or(0, |left| left.wrapping_add(1)));
        word(self.bytes_written);
        for sector in &self.sectors {
            word(u64::from(sector.erases));
            for chunk in sector.written.chunks(8) {
                let mut bytes = [BLANK; 8];
                bytes[..chunk.len()].copy_from_slice(chunk);
                word(u64::from_le_bytes(bytes));
            }
        }
    }
}

/// A program's connection to its [`Chip`].
///
/// Operations take no time: the program waits for them as it does on a chip that shares its bus
/// with the code.
#[derive(Debug)]
pub struct SimFlash {
    chip: Rc<RefCell<Chip>>,
    session: u32,
    /// The body that resets when the power goes; none outside of a world.
    wire: Option<Wire>,
}

impl SimFlash {
    /// Opens a chip.
    pub fn open(chip: &Rc<RefCell<Chip>>) -> Self {
        Self {
            session: chip.borrow().session,
            chip: Rc::clone(chip),
            wire: None,
        }
    }

    /// See [`Chip::image`].
    #[cfg(feature = "recording")]
    pub(crate) fn image(&self) -> Vec<Vec<u8>> {
        self.chip.borrow().image()
    }

    pub(crate) fn of_body(wire: &Wire) -> Self {
        Self {
            wire: Some(wire.clone()),
            ..Self::open(&wire.ports.chip)
        }
    }

    fn run<R>(
        &self,
        operation: impl FnOnce(&mut Chip) -> Result<R, FlashError>,
    ) -> Result<R, FlashError> {
        let (result, cut) = {
            let chip = &mut *self.chip.borrow_mut();
            if !chip.powered || chip.session != self.session {
                return Err(FlashError::PowerLost);
            }
            let result = operation(chip);
            (result, !chip.powered)
        };
        if cut && let Some(wire) = &self.wire {
            // What cut the memory's power cut the controller's.
            wire.ports.ask_reset(ResetCause::BrownOut);
        }
        result
    }
}

impl ErrorType for SimFlash {
    type Error = FlashError;
}

impl ReadNorFlash for SimFlash {
    const READ_SIZE: usize = WRITE_BYTES;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.run(|chip| chip.read(offset, bytes))
    }

    fn capacity(&self) -> usize {
        self.chip.borrow().capacity()
    }
}

impl NorFlash for SimFlash {
    const WRITE_SIZE: usize = WRITE_BYTES;
    const ERASE_SIZE: usize = ERASE_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.run(|chip| chip.erase(from, to))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.run(|chip| chip.write(offset, bytes))
    }
}

// The chips of these boards allow it: a second write may clear more bits.
impl MultiwriteNorFlash for SimFlash {}
