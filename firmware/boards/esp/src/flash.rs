//! Regions of the flash, as the partition table names them.
//!
//! The chip runs its program from the same flash. While a sector is erased (45 ms on a new flash,
//! at most 400 ms on a worn one) nothing else runs, the second core included: the motors keep
//! their duty for that long, and the watchdogs wait longer.

use core::cell::RefCell;

#[cfg(feature = "esp32s3")]
use crawler_hal::ModelRegion;
use crawler_hal::{SlotPort, SlotRegion};
use crawler_release::Chip;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_storage_async::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use esp_bootloader_esp_idf::partitions::{
    Error, PARTITION_TABLE_MAX_LEN, PartitionEntry, PartitionTable, read_partition_table,
};
use esp_hal::peripherals::FLASH;
use esp_storage::{FlashStorage, FlashStorageError};
use static_cell::StaticCell;

/// Types of partitions that hold a program, and data, and the subtypes of slots and select entries (ESP-IDF
/// programming guide, "Partition Tables").
const APP: u8 = 0;
const DATA: u8 = 1;
const OTA_0: u8 = 0x10;
const OTA_1: u8 = 0x11;
const OTADATA: u8 = 0;
/// Bytes that are erased at a time.
pub(crate) const SECTOR: u32 = FlashStorage::SECTOR_SIZE;
/// The chip in the header of an image.
const CHIP: Chip = if cfg!(feature = "esp32c3") {
    Chip::ESP32_C3
} else if cfg!(feature = "esp32c6") {
    Chip::ESP32_C6
} else {
    Chip::ESP32_S3
};

/// The one flash, behind the one lock. The lock is that of interrupts: on a chip with two cores,
/// the other one then holds no lock when it is parked for a write.
type Shared = Mutex<CriticalSectionRawMutex, RefCell<FlashStorage<'static>>>;

/// The regions of the program.
pub(crate) struct Regions {
    /// What `set` changed.
    pub(crate) parameters: Region,
    /// What a person told the robot.
    pub(crate) settings: Region,
    /// Two programs; `None` when the partition table has no two slots, or the program runs from neither.
    pub(crate) slots: Option<SlotPort<Region>>,
    /// Where models for the detector are, in the flash of the slots; `None` when the partition table has no room for
    /// them, as that of a board which was flashed before there were any.
    #[cfg(feature = "esp32s3")]
    pub(crate) models: Option<ModelRegion>,
    /// The same of policies.
    #[cfg(feature = "esp32s3")]
    pub(crate) policies: Option<ModelRegion>,
}

/// Reads the partition table. What it lacks becomes a region without flash, whose every use is
/// answered with an error: the robot runs, and forgets.
pub(crate) fn regions(flash: FLASH<'static>) -> Regions {
    static SHARED: StaticCell<Shared> = StaticCell::new();

    let storage = FlashStorage::new(flash);
    #[cfg(feature = "esp32s3")]
    let storage = storage.multicore_auto_park();
    let shared: &'static Shared = SHARED.init(Mutex::new(RefCell::new(storage)));
    Regions {
        parameters: Region::find(shared, "params"),
        settings: Region::find(shared, "settings"),
        slots: slots(shared),
        #[cfg(feature = "esp32s3")]
        models: models(shared, "models"),
        #[cfg(feature = "esp32s3")]
        policies: models(shared, "policies"),
    }
}

/// The places for models in the partition of this name: behind two sectors of select entries two halves of what is left.
#[cfg(feature = "esp32s3")]
fn models(shared: &'static Shared, name: &str) -> Option<ModelRegion> {
    let found = shared.lock(|flash| place(&mut flash.borrow_mut(), name));
    let region = found.ok().flatten().and_then(|(select, length)| {
        let start = select + 2 * SECTOR;
        let half = length.checked_sub(2 * SECTOR)? / 2;
        let length = half - half % SECTOR;
        // A journal, and at least one sector of a model.
        (length >= 2 * SECTOR).then(|| ModelRegion {
            select,
            places: [start, start + length].map(|start| SlotRegion { start, length }),
        })
    });
    if region.is_none() {
        defmt::warn!("flash: no partition '{=str}', so updates bring none", name);
    }
    region
}

/// The slots, as the partition table has them.
fn slots(shared: &'static Shared) -> Option<SlotPort<Region>> {
    let found = shared.lock(|flash| find_slots(&mut flash.borrow_mut(), shared));
    let slots = found.unwrap_or_default();
    if slots.is_none() {
        defmt::error!("flash: no two slots, so there are no updates");
    }
    slots
}

/// Finds where the select entries and the slots are, and which slot runs. `None` where there are none, or the
/// program runs from neither.
fn find_slots(
    flash: &mut FlashStorage<'static>,
    shared: &'static Shared,
) -> Result<Option<SlotPort<Region>>, Error> {
    let mut bytes = [0; PARTITION_TABLE_MAX_LEN];
    let table = read_partition_table(flash, &mut bytes)?;
    let capacity = flash.capacity() as u32;
    let place = |kind, subtype| {
        place_of(&table, capacity, |entry| {
            entry.raw_type() == kind && entry.raw_subtype() == subtype
        })
    };
    let (Some((otadata, length)), Some(first), Some(second)) =
        (place(DATA, OTADATA), place(APP, OTA_0), place(APP, OTA_1))
    else {
        return Ok(None);
    };
    let slots = [first, second].map(|(start, length)| SlotRegion { start, length });
    let booted = table.booted_partition()?.map(|entry| entry.offset());
    let running = slots.iter().position(|slot| Some(slot.start) == booted);
    Ok(running
        .filter(|_| length >= 2 * SECTOR)
        .map(|running| SlotPort {
            flash: Region {
                flash: Some(shared),
                start: 0,
                length: capacity,
            },
            otadata,
            slots,
            running: running as u8,
            chip: CHIP.0,
        }))
}

/// Why the flash did not serve. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub(crate) enum RegionError {
    /// The partition table has no such partition: flash the board with its table.
    Absent,
    /// Beyond the region: a mistake of the program.
    OutOfBounds,
    /// Not at a word, or for erasing at a sector: a mistake of the program.
    NotAligned,
    /// The flash says no.
    Refused,
}

impl NorFlashError for RegionError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            Self::Absent | Self::Refused => NorFlashErrorKind::Other,
        }
    }
}

impl From<FlashStorageError> for RegionError {
    fn from(error: FlashStorageError) -> Self {
        match error {
            FlashStorageError::NotAligned => Self::NotAligned,
            FlashStorageError::OutOfBounds => Self::OutOfBounds,
            _ => Self::Refused,
        }
    }
}

/// A partition, from address 0 on.
pub(crate) struct Region {
    flash: Option<&'static Shared>,
    start: u32,
    length: u32,
}

impl Region {
    const ABSENT: Self = Self {
        flash: None,
        start: 0,
        length: 0,
    };

    fn find(shared: &'static Shared, label: &'static str) -> Self {
        match shared.lock(|flash| place(&mut flash.borrow_mut(), label)) {
            Ok(Some((start, length))) => Self {
                flash: Some(shared),
                start,
                length,
            },
            Ok(None) => {
                defmt::error!("flash: no partition '{=str}', so nothing is kept", label);
                Self::ABSENT
            }
            Err(error) => {
                defmt::error!(
                    "flash: partition table unreadable ({}), so '{=str}' is not kept",
                    error,
                    label
                );
                Self::ABSENT
            }
        }
    }

    /// Runs `work` on the flash with the address of `offset`, when `length` bytes from there are
    /// within the region.
    fn with(
        &self,
        offset: u32,
        length: usize,
        work: impl FnOnce(&mut FlashStorage<'static>, u32) -> Result<(), FlashStorageError>,
    ) -> Result<(), RegionError> {
        let shared = self.flash.ok_or(RegionError::Absent)?;
        let end = u32::try_from(length)
            .ok()
            .and_then(|length| offset.checked_add(length))
            .filter(|end| *end <= self.length);
        if end.is_none() {
            return Err(RegionError::OutOfBounds);
        }
        shared
            .lock(|flash| work(&mut flash.borrow_mut(), self.start + offset))
            .map_err(RegionError::from)
    }
}

/// Finds where the partition `label` lies. `None` when there is none, or none that makes sense.
fn place(flash: &mut FlashStorage<'static>, label: &str) -> Result<Option<(u32, u32)>, Error> {
    let mut table = [0; PARTITION_TABLE_MAX_LEN];
    let table = read_partition_table(flash, &mut table)?;
    let capacity = flash.capacity() as u32;
    Ok(place_of(&table, capacity, |entry| {
        let name = entry.label();
        let end = name.iter().position(|byte| *byte == 0);
        entry.raw_type() == DATA && &name[..end.unwrap_or(name.len())] == label.as_bytes()
    }))
}

/// Start and length of the first partition that `wanted` asks for and that may be written; `None` when there is
/// none, or none that makes sense.
fn place_of(
    table: &PartitionTable<'_>,
    capacity: u32,
    wanted: impl Fn(&PartitionEntry) -> bool,
) -> Option<(u32, u32)> {
    table
        .iter()
        .find(|entry| !entry.is_read_only() && wanted(entry))
        .map(|entry| (entry.offset(), entry.len()))
        .filter(|(start, length)| {
            let end = start.checked_add(*length);
            start.is_multiple_of(SECTOR)
                && length.is_multiple_of(SECTOR)
                && *length > 0
                && end.is_some_and(|end| end <= capacity)
        })
}

impl ErrorType for Region {
    type Error = RegionError;
}

impl ReadNorFlash for Region {
    const READ_SIZE: usize = FlashStorage::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), RegionError> {
        self.with(offset, bytes.len(), |flash, at| flash.read_nor(at, bytes))
    }

    fn capacity(&self) -> usize {
        self.length as usize
    }
}

impl NorFlash for Region {
    const WRITE_SIZE: usize = FlashStorage::WRITE_SIZE;
    const ERASE_SIZE: usize = FlashStorage::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), RegionError> {
        let length = to.checked_sub(from).ok_or(RegionError::OutOfBounds)?;
        if length == 0 {
            return Ok(());
        }
        // One sector at a time: whatever waits runs in between.
        if !from.is_multiple_of(SECTOR) || !length.is_multiple_of(SECTOR) {
            return Err(RegionError::NotAligned);
        }
        for sector in (from..to).step_by(SECTOR as usize) {
            self.with(sector, SECTOR as usize, |flash, at| {
                flash.erase(at, at + SECTOR)
            })?;
            embassy_futures::yield_now().await;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), RegionError> {
        self.with(offset, bytes.len(), |flash, at| flash.write_nor(at, bytes))
    }
}

impl MultiwriteNorFlash for Region {}
