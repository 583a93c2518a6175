//! NOR flash that holds the caller to the rules and may lose its power at any byte.
//!
//! A chip has two regions, each with addresses of its own: one for parameters ([`SimFlash`]), and one with
//! the two slots for programs, two places for a model of the detector, two for a policy, and the select entries of each
//! ([`SimSlots`]). In the second one operations take time.
//!
//! Reading order: `sector` is what a sector holds, and how robots share it; this file is the chip;
//! `timing` says how long it takes, `handles` are what programs hold of it.

mod handles;
mod sector;
mod timing;

use std::cell::RefCell;
use std::rc::Rc;

use crawler_app::policy::MAX_BYTES;
use crawler_hal::{Instant, ModelRegion, SlotRegion};
use embedded_storage_async::nor_flash::{NorFlashError, NorFlashErrorKind};
use rand_core::Rng;
use rand_pcg::Pcg32;

use crate::world::{Purpose, stream};
use sector::Sector;

pub(super) use handles::BootFlash;
pub use handles::{SimFlash, SimSlots};
pub(crate) use sector::Pages;

/// Bytes of an erase block.
pub const ERASE_BYTES: usize = 4_096;
/// Bytes of a word: reads and writes are aligned to it, as on the ESP32.
pub const WRITE_BYTES: usize = 4;

/// Contents of an erased byte.
const BLANK: u8 = 0xFF;

/// Where the select entries are in the region of the slots: two sectors.
pub const OTADATA_AT: u32 = 0;
/// The places for a model in that region, behind select entries of their own. The last sector of each is the journal of
/// its update.
pub const MODELS: ModelRegion = ModelRegion {
    select: 0x2000,
    places: [place(0), place(1)],
};
/// Bytes of a place for a model.
const PLACE_BYTES: u32 = 88 * 1_024;
/// The slots in that region. The last sector of each is the journal of its update.
pub const SLOTS: [SlotRegion; 2] = [slot(0), slot(1)];
/// Bytes of a slot.
const SLOT_BYTES: u32 = 768 * 1_024;
/// The places for a policy in that region, behind the slots, as those for a model.
pub const POLICIES: ModelRegion = ModelRegion {
    select: slot(1).start + SLOT_BYTES,
    places: [policy(0), policy(1)],
};
/// Bytes of a place for a policy: the largest there is, and the journal of its update.
const POLICY_BYTES: u32 = (MAX_BYTES + ERASE_BYTES) as u32;
/// Sectors of the region: the slots, behind three blocks of 64 KiB with select entries and models, and policies.
const SLOT_SECTORS: usize = (policy(1).start + POLICY_BYTES) as usize / ERASE_BYTES;

const fn slot(index: u32) -> SlotRegion {
    SlotRegion {
        start: 0x3_0000 + index * SLOT_BYTES,
        length: SLOT_BYTES,
    }
}

const fn place(index: u32) -> SlotRegion {
    SlotRegion {
        start: 0x4000 + index * PLACE_BYTES,
        length: PLACE_BYTES,
    }
}

const fn policy(index: u32) -> SlotRegion {
    SlotRegion {
        start: slot(1).start + SLOT_BYTES + 0x2000 + index * POLICY_BYTES,
        length: POLICY_BYTES,
    }
}

const _: () = assert!(MAX_BYTES.is_multiple_of(ERASE_BYTES));
const _: () = assert!(place(1).start + PLACE_BYTES <= SLOTS[0].start);

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

/// What a chip holds when its power is off, and the cut that is planned.
#[cfg(feature = "live")]
#[derive(Debug, Clone, Default)]
pub(crate) struct Contents {
    parameters: Vec<Sector>,
    slots: Vec<Sector>,
    budget: Option<u64>,
}

#[cfg(feature = "live")]
impl Contents {
    /// Memory of the host that it takes, in bytes. What robots share is not counted.
    pub(crate) fn footprint(&self) -> usize {
        let sectors = || self.parameters.iter().chain(&self.slots);
        let own: usize = sectors().map(Sector::footprint).sum();
        own + sectors().count() * size_of::<Sector>()
    }
}

/// The parts of a chip, each with addresses from 0 on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Region {
    Parameters,
    Slots,
}

/// An operation that has begun and takes time.
#[derive(Debug)]
struct Running {
    what: Operation,
    /// When it is over, in the time of the world.
    until: Instant,
}

#[derive(Debug, Clone)]
pub(crate) enum Operation {
    /// Programs these bytes from an address on.
    Program { at: u32, bytes: Vec<u8> },
    /// Erases from one address to another.
    Erase { from: u32, to: u32 },
}

impl Operation {
    /// How many bytes it changes.
    pub(crate) fn length(&self) -> u64 {
        match self {
            Self::Program { bytes, .. } => bytes.len() as u64,
            Self::Erase { from, to } => u64::from(to.saturating_sub(*from)),
        }
    }
}

/// The memory itself, which outlives the programs that use it.
#[derive(Debug)]
pub struct Chip {
    parameters: Vec<Sector>,
    /// As many as were ever written or erased, and those before them.
    slots: Vec<Sector>,
    /// What sectors of slots share with those of other robots of the world.
    pages: Option<Rc<RefCell<Pages>>>,
    rng: Pcg32,
    powered: bool,
    /// Bytes that may still be written or erased before the power goes.
    budget: Option<u64>,
    /// Handles opened before the last power-up are disconnected.
    session: u32,
    /// What goes on in the slots.
    running: Option<Running>,
    violations: u32,
    bytes_written: u64,
    /// What programs did in the slots.
    #[cfg(test)]
    operations: Vec<Operation>,
}

impl Chip {
    pub(crate) fn new(sectors: usize, rng: Pcg32) -> Self {
        Self {
            parameters: vec![Sector::default(); sectors],
            slots: Vec::new(),
            pages: None,
            rng,
            powered: true,
            budget: None,
            session: 0,
            running: None,
            violations: 0,
            bytes_written: 0,
            #[cfg(test)]
            operations: Vec::new(),
        }
    }

    /// The same, sharing pages with others.
    pub(crate) fn sharing(self, pages: &Rc<RefCell<Pages>>) -> Self {
        Self {
            pages: Some(Rc::clone(pages)),
            ..self
        }
    }

    /// An erased chip with so many sectors of [`ERASE_BYTES`] for parameters, outside of any world. What a
    /// torn write leaves behind is drawn from `seed`.
    pub fn blank(sectors: u16, seed: u64) -> Rc<RefCell<Self>> {
        let rng = stream(seed, 0, Purpose::Flash);
        Rc::new(RefCell::new(Self::new(usize::from(sectors), rng)))
    }

    /// What is written in each sector for parameters; the rest of it is blank.
    #[cfg(feature = "recording")]
    fn image(&self) -> Vec<Vec<u8>> {
        let sectors = self.parameters.iter();
        sectors.map(|sector| sector.written().to_vec()).collect()
    }

    /// A chip with these parameters, outside of any world.
    #[cfg(feature = "recording")]
    pub(crate) fn of_image<'a>(image: impl ExactSizeIterator<Item = &'a [u8]>) -> Self {
        let mut chip = Self::new(image.len(), stream(0, 0, Purpose::Flash));
        for (sector, bytes) in chip.parameters.iter_mut().zip(image) {
            sector.load(bytes);
        }
        chip
    }

    /// What is in it.
    #[cfg(feature = "live")]
    pub(crate) fn contents(&self) -> Contents {
        Contents {
            parameters: self.parameters.clone(),
            slots: self.slots.clone(),
            budget: self.budget,
        }
    }

    /// Has these parameters and this planned cut from now on, which are those of a chip of the same size.
    #[cfg(feature = "live")]
    pub(crate) fn fill(&mut self, contents: &Contents) {
        for (sector, kept) in self.parameters.iter_mut().zip(&contents.parameters) {
            sector.clone_from(kept);
        }
        self.budget = contents.budget;
    }

    /// Has these slots from now on.
    #[cfg(feature = "live")]
    pub(crate) fn fill_slots(&mut self, contents: &Contents) {
        self.slots.clone_from(&contents.slots);
    }

    /// Cuts the power once so many more bytes were written or erased; the byte at which it
    /// happens is left half done. `0` tears the very next one.
    pub fn cut_power_after(&mut self, bytes: u64) {
        self.budget = Some(bytes);
    }

    /// Replaces all parameters by noise drawn from `seed`.
    pub fn fill_with_noise(&mut self, seed: u64) {
        let mut rng = stream(seed, 1, Purpose::Flash);
        for sector in &mut self.parameters {
            sector.fill(|bytes| rng.fill_bytes(bytes));
        }
    }

    /// Takes a planned cut back. Power that is gone stays gone.
    pub fn keep_power(&mut self) {
        self.budget = None;
    }

    /// Cuts the power: between two operations, or within the one that goes on, at a byte drawn by chance.
    pub fn lose_power(&mut self) {
        if self.powered
            && let Some(running) = &self.running
        {
            let length = running.what.length().max(1);
            self.budget = Some(self.rng.next_u64() % length);
            // It is torn: that is what was asked for.
            let _ = self.settle();
        }
        self.running = None;
        self.powered = false;
    }

    /// Starts the controller anew, with no cut planned: the power is on again, if it was off. Handles opened
    /// before are disconnected. An operation that went on is brought to its end, as a chip does whose
    /// controller alone was reset.
    pub fn restore_power(&mut self) {
        if self.powered {
            // Where the power goes in it, it comes back at once.
            let _ = self.settle();
        }
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

    /// How often a sector for parameters was erased; `None` when there is no such sector.
    pub fn erases(&self, sector: usize) -> Option<u32> {
        self.parameters.get(sector).map(|sector| sector.erases)
    }

    /// Memory of the host that the contents take, in bytes: what was written, not the regions, and without
    /// what it shares.
    pub fn footprint(&self) -> usize {
        let sectors = self.parameters.iter().chain(&self.slots);
        let own: usize = sectors.map(Sector::footprint).sum();
        own + self.slots.capacity() * size_of::<Sector>()
    }

    /// Bytes written so far.
    pub const fn bytes_written(&self) -> u64 {
        self.bytes_written
    }

    /// What programs did in the slots, in order; what boots did is not in it.
    #[cfg(test)]
    pub(crate) fn operations(&self) -> &[Operation] {
        &self.operations
    }

    /// Clears some bytes in the region of the slots, as flash that decays may.
    #[cfg(test)]
    pub(crate) fn spoil(&mut self, at: u32) {
        let (index, within) = (at as usize / ERASE_BYTES, at as usize % ERASE_BYTES);
        self.sector(Region::Slots, index).program(within, &[0; 16]);
    }

    /// Whether nothing was ever written into the slots or their select entries.
    pub(super) fn has_unused_slots(&self) -> bool {
        self.slots.iter().all(Sector::is_unused)
    }

    /// Whether nothing was ever written into the first sector of this slot, nor erased.
    pub(super) fn is_untouched(&self, slot: SlotRegion) -> bool {
        let first = slot.start as usize / ERASE_BYTES;
        self.slots.get(first).is_none_or(Sector::is_unused)
    }

    const fn capacity(&self, region: Region) -> usize {
        let sectors = match region {
            Region::Parameters => self.parameters.len(),
            Region::Slots => SLOT_SECTORS,
        };
        sectors * ERASE_BYTES
    }

    fn sectors(&mut self, region: Region) -> &mut Vec<Sector> {
        match region {
            Region::Parameters => &mut self.parameters,
            Region::Slots => &mut self.slots,
        }
    }

    /// A sector within the region, to be changed.
    fn sector(&mut self, region: Region, index: usize) -> &mut Sector {
        let sectors = self.sectors(region);
        if index >= sectors.len() {
            sectors.resize_with(index + 1, Sector::default);
        }
        &mut sectors[index]
    }

    fn byte(&mut self, region: Region, at: usize) -> u8 {
        let sector = self.sectors(region).get(at / ERASE_BYTES);
        sector.map_or(BLANK, |sector| sector.byte(at % ERASE_BYTES))
    }

    fn broken(&mut self, rule: FlashError) -> FlashError {
        self.violations = self.violations.saturating_add(1);
        rule
    }

    fn check(
        &mut self,
        region: Region,
        from: u32,
        length: usize,
        unit: usize,
    ) -> Result<usize, FlashError> {
        let from = from as usize;
        if !from.is_multiple_of(unit) || !length.is_multiple_of(unit) {
            return Err(self.broken(FlashError::NotAligned));
        }
        if from
            .checked_add(length)
            .is_none_or(|end| end > self.capacity(region))
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

    /// Takes so many bytes from the budget at once; false when it has not as many, and nothing is taken.
    fn spend_all(&mut self, bytes: usize) -> bool {
        match &mut self.budget {
            None => true,
            Some(left) => match left.checked_sub(bytes as u64) {
                Some(rest) => {
                    *left = rest;
                    true
                }
                None => false,
            },
        }
    }

    fn read(&mut self, region: Region, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let mut at = self.check(region, offset, bytes.len(), WRITE_BYTES)?;
        let mut rest = bytes;
        while !rest.is_empty() {
            let within = at % ERASE_BYTES;
            let (piece, behind) = rest.split_at_mut(rest.len().min(ERASE_BYTES - within));
            let written = self.sectors(region).get(at / ERASE_BYTES);
            let written = written.map_or(&[][..], Sector::written);
            let written = written.get(within..).unwrap_or(&[]);
            let known = written.len().min(piece.len());
            piece[..known].copy_from_slice(&written[..known]);
            piece[known..].fill(BLANK);
            at += piece.len();
            rest = behind;
        }
        Ok(())
    }

    /// Whether these bytes may be written here.
    fn check_write(
        &mut self,
        region: Region,
        offset: u32,
        bytes: &[u8],
    ) -> Result<usize, FlashError> {
        let from = self.check(region, offset, bytes.len(), WRITE_BYTES)?;
        let rises = (from..)
            .zip(bytes)
            .any(|(at, &new)| new & !self.byte(region, at) != 0);
        if rises {
            return Err(self.broken(FlashError::NotErased));
        }
        Ok(from)
    }

    fn write(&mut self, region: Region, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let mut at = self.check_write(region, offset, bytes)?;
        let mut rest = bytes;
        while !rest.is_empty() {
            let within = at % ERASE_BYTES;
            let (piece, behind) = rest.split_at(rest.len().min(ERASE_BYTES - within));
            if !self.spend_all(piece.len()) {
                return self.tear(region, at, piece);
            }
            self.bytes_written += piece.len() as u64;
            let index = at / ERASE_BYTES;
            self.sector(region, index).program(within, piece);
            at += piece.len();
            rest = behind;
            if region == Region::Slots
                && at.is_multiple_of(ERASE_BYTES)
                && let Some(pages) = self.pages.clone()
            {
                self.sector(region, index).share(&mut pages.borrow_mut());
            }
        }
        Ok(())
    }

    /// Writes until the budget ends, which it does within `bytes`.
    fn tear(&mut self, region: Region, from: usize, bytes: &[u8]) -> Result<(), FlashError> {
        for (at, &new) in (from..).zip(bytes) {
            let whole = self.spend();
            // Some of the bits that were to fall did.
            let left = if whole { 0 } else { self.rng.next_u32() as u8 };
            let sector = self.sector(region, at / ERASE_BYTES);
            let old = sector.byte(at % ERASE_BYTES);
            sector.set(at % ERASE_BYTES, old & (new | left));
            if !whole {
                return Err(FlashError::PowerLost);
            }
            self.bytes_written += 1;
        }
        Ok(())
    }

    fn check_erase(&mut self, region: Region, from: u32, to: u32) -> Result<usize, FlashError> {
        let Some(length) = to.checked_sub(from) else {
            return Err(self.broken(FlashError::OutOfBounds));
        };
        self.check(region, from, length as usize, ERASE_BYTES)
    }

    fn erase(&mut self, region: Region, from: u32, to: u32) -> Result<(), FlashError> {
        let from = self.check_erase(region, from, to)?;
        for index in from / ERASE_BYTES..to as usize / ERASE_BYTES {
            let whole = self.spend_all(ERASE_BYTES);
            let sector = self.sector(region, index);
            sector.erases = sector.erases.saturating_add(1);
            if whole {
                sector.clear();
                continue;
            }
            for at in 0..ERASE_BYTES {
                if self.powered && self.spend() {
                    self.sector(region, index).set(at, BLANK);
                } else {
                    // All cells rise together; where it stopped, some bits have, some not.
                    let risen = self.rng.next_u32() as u8;
                    let sector = self.sector(region, index);
                    sector.set(at, sector.byte(at) | risen);
                }
            }
            return Err(FlashError::PowerLost);
        }
        Ok(())
    }

    /// Begins an operation in the slots that is over at `until`.
    fn begin(&mut self, what: Operation, until: Instant) {
        debug_assert!(self.running.is_none(), "the chip does one thing at a time");
        #[cfg(test)]
        self.operations.push(what.clone());
        self.running = Some(Running { what, until });
    }

    /// When the operation is over that goes on.
    fn busy_until(&self) -> Option<Instant> {
        self.running.as_ref().map(|running| running.until)
    }

    /// Brings the operation to its end that goes on, if there is one.
    fn settle(&mut self) -> Result<(), FlashError> {
        match self.running.take().map(|running| running.what) {
            None => Ok(()),
            Some(Operation::Program { at, bytes }) => self.write(Region::Slots, at, &bytes),
            Some(Operation::Erase { from, to }) => self.erase(Region::Slots, from, to),
        }
    }

    pub(crate) fn fingerprint(&self, mut word: impl FnMut(u64)) {
        word(self.rng.clone().next_u64());
        word(u64::from(self.powered) | u64::from(self.session) << 1);
        word(self.budget.map_or(0, |left| left.wrapping_add(1)));
        word(self.bytes_written);
        for sector in &self.parameters {
            sector.fingerprint(&mut word);
        }
        // Nothing of a robot that was never updated.
        for (index, sector) in self.slots.iter().enumerate() {
            if !sector.is_unused() {
                word(index as u64);
                sector.fingerprint(&mut word);
            }
        }
        if let Some(running) = &self.running {
            word(running.until.as_micros());
        }
    }
}
