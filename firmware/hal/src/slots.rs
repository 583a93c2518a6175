//! The two places for the program, and what decides between them.

use embedded_storage_async::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

/// The flash that holds the programs of a robot, and where in it they are. All addresses are in bytes, of the
/// address space of `flash`, and multiples of its sectors of 4,096 bytes; no region overlaps another.
///
/// It belongs to one activity, and what else is in the flash belongs to others: the owner touches nothing
/// outside of these regions, and of the slot that runs nothing but its last sector.
#[derive(Debug)]
pub struct SlotPort<F> {
    /// Programs bits from 1 to 0, word by word, also in words that were programmed before.
    pub flash: F,
    /// Where the two sectors of select entries begin, as ESP-IDF's partition `otadata` has them.
    pub otadata: u32,
    /// The slots, in the order in which select entries count them.
    pub slots: [SlotRegion; 2],
    /// Index of the slot whose program runs, 0 or 1. Whoever started it knows, and not the select entries: a
    /// boot stage passes over a slot without an intact program.
    pub running: u8,
    /// The chip that an image must be for, as `esp_chip_id_t` of ESP-IDF numbers them; `0xFFFF` where there is
    /// none.
    pub chip: u16,
}

/// Where a slot is. Its last sector is the journal of the update that is in it; an image may fill the rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SlotRegion {
    /// Address of the first byte.
    pub start: u32,
    /// Bytes, with the last sector.
    pub length: u32,
}

/// Where the two places for a model are, in the flash of a [`SlotPort`]. Like the slots they have select entries, which
/// count three things: what the program was built with, and the first and the second place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelRegion {
    /// Where the two sectors of select entries begin.
    pub select: u32,
    /// The places. The last sector of each is the journal of the update that is in it; a model may fill the rest.
    pub places: [SlotRegion; 2],
}

/// The slots of a body that takes no updates: there is no value of this type.
#[derive(Debug, Clone, Copy)]
pub enum NoSlots {}

/// An error of [`NoSlots`], which is never made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoSlotsError {}

impl NorFlashError for NoSlotsError {
    fn kind(&self) -> NorFlashErrorKind {
        match *self {}
    }
}

impl ErrorType for NoSlots {
    type Error = NoSlotsError;
}

impl ReadNorFlash for NoSlots {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, _offset: u32, _bytes: &mut [u8]) -> Result<(), NoSlotsError> {
        match *self {}
    }

    fn capacity(&self) -> usize {
        match *self {}
    }
}

impl NorFlash for NoSlots {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = 4_096;

    async fn erase(&mut self, _from: u32, _to: u32) -> Result<(), NoSlotsError> {
        match *self {}
    }

    async fn write(&mut self, _offset: u32, _bytes: &[u8]) -> Result<(), NoSlotsError> {
        match *self {}
    }
}

impl MultiwriteNorFlash for NoSlots {}
