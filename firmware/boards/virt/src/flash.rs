//! The parallel flash: the second bank of the machine, with parameters, settings and programs.
//!
//! What lies where: [`crawler_image_format::layout`]. Where the emulator was started without a file for that bank,
//! it is RAM of zeros and forgets with the emulator.

use crawler_board::EmbassyClock;
use crawler_board::cfi::{
    Bus, CfiError, CfiFlash, Chips, ERASE_BLOCK, SharedChips, SlotFlash, WORD,
};
use crawler_image_format::layout::{self, BANK_ADDRESS, PARAMETER_BLOCKS, SETTINGS_BLOCKS};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use rand_core::Rng;

/// Bytes of noise at the start and at the end of a block.
const NOISE: u32 = 256;
/// What a flash reports that refuses on request: writing and erasure failed, in both chips.
const REFUSAL: u32 = 0x00B0_00B0;

const _: () = assert!(layout::ERASE_BLOCK == ERASE_BLOCK);

/// The one value that reaches the bank.
static CHIPS: SharedChips<CriticalSectionRawMutex, Bank, EmbassyClock> =
    Mutex::new(Chips::new(Bank(()), EmbassyClock));

/// The bank, by its address.
#[derive(Debug)]
pub struct Bank(());

impl Bus for Bank {
    fn read(&self, offset: u32) -> u32 {
        let place = (BANK_ADDRESS + offset) as *const u32;
        // SAFETY: within the bank, as regions check bounds; reading it has no side effect.
        unsafe { place.read_volatile() }
    }

    fn write(&mut self, offset: u32, word: u32) {
        let place = (BANK_ADDRESS + offset) as *mut u32;
        // SAFETY: within the bank; only this value writes there, and there is one.
        unsafe { place.write_volatile(word) };
    }
}

/// A region of the bank.
type Region = CfiFlash<'static, CriticalSectionRawMutex, Bank, EmbassyClock>;

/// The region of settings.
pub type SettingsFlash = Region;
/// The flash of the programs.
pub type Programs = SlotFlash<'static, CriticalSectionRawMutex, Bank, EmbassyClock>;

/// The region of settings.
pub const fn settings() -> SettingsFlash {
    CfiFlash::new(&CHIPS, PARAMETER_BLOCKS, SETTINGS_BLOCKS)
}

/// Asks the chips what they are, before anything else is in them.
///
/// # Errors
/// [`CfiError::Absent`] or [`CfiError::Geometry`].
pub fn probe() -> Result<(), CfiError> {
    embassy_futures::block_on(CHIPS.lock()).probe(layout::BANK)
}

/// The flash of the programs.
pub const fn programs() -> Programs {
    SlotFlash::new(&CHIPS)
}

/// The parameter region.
#[derive(Debug)]
pub struct ParameterFlash {
    region: Region,
    refuses: bool,
}

impl ParameterFlash {
    /// The region; with `refuses` each write and erasure fails, as in a worn flash.
    pub const fn new(refuses: bool) -> Self {
        Self {
            region: CfiFlash::new(&CHIPS, 0, PARAMETER_BLOCKS),
            refuses,
        }
    }

    /// Asks the chips what they are.
    ///
    /// # Errors
    /// [`CfiError::Absent`] or [`CfiError::Geometry`].
    pub async fn probe(&mut self) -> Result<(), CfiError> {
        self.region.probe().await
    }

    /// Fills both ends of each block with noise, as flash that another program used.
    ///
    /// # Errors
    /// Those of the chips.
    pub async fn scribble(&mut self, rng: &mut impl Rng) -> Result<(), CfiError> {
        let end = u32::from(PARAMETER_BLOCKS) * ERASE_BLOCK;
        self.region.erase(0, end).await?;
        for start in (0..end).step_by(ERASE_BLOCK as usize) {
            for part in [start, start + ERASE_BLOCK - NOISE] {
                for at in (part..part + NOISE).step_by(WORD as usize) {
                    self.region.write(at, &rng.next_u32().to_le_bytes()).await?;
                }
            }
        }
        Ok(())
    }
}

impl ErrorType for ParameterFlash {
    type Error = CfiError;
}

impl ReadNorFlash for ParameterFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), CfiError> {
        self.region.read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.region.capacity()
    }
}

impl NorFlash for ParameterFlash {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = ERASE_BLOCK as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), CfiError> {
        if self.refuses {
            return Err(CfiError::Refused(REFUSAL));
        }
        self.region.erase(from, to).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), CfiError> {
        if self.refuses {
            return Err(CfiError::Refused(REFUSAL));
        }
        self.region.write(offset, bytes).await
    }
}
