//! The parallel flash with the parameters: the second bank of the machine.
//!
//! The program gets the first [`BLOCKS`] erase blocks of 256 KiB. Where the emulator was started
//! without a file for that bank, it is RAM of zeros and forgets with the emulator.

use crawler_board::EmbassyClock;
use crawler_board::cfi::{Bus, CfiError, CfiFlash, ERASE_BLOCK, WORD};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use rand_core::Rng;

use crate::machine::FLASH;

/// Erase blocks of the region.
pub const BLOCKS: u16 = 4;
/// Bytes of noise at the start and at the end of a block.
const NOISE: u32 = 256;
/// What a flash reports that refuses on request: writing and erasure failed, in both chips.
const REFUSAL: u32 = 0x00B0_00B0;

/// The bank, by its address.
#[derive(Debug)]
pub struct Bank(());

impl Bus for Bank {
    fn read(&self, offset: u32) -> u32 {
        let place = (FLASH + offset as usize) as *const u32;
        // SAFETY: within the bank, as the driver checks bounds; reading it has no side effect.
        unsafe { place.read_volatile() }
    }

    fn write(&mut self, offset: u32, word: u32) {
        let place = (FLASH + offset as usize) as *mut u32;
        // SAFETY: within the bank; only this value writes there, as there is one.
        unsafe { place.write_volatile(word) };
    }
}

/// The parameter region.
#[derive(Debug)]
pub struct ParameterFlash {
    chips: CfiFlash<Bank, EmbassyClock>,
    refuses: bool,
}

impl ParameterFlash {
    /// The region; with `refuses` each write and erasure fails, as in a worn flash.
    ///
    /// # Safety
    /// There may be one value of this.
    pub unsafe fn new(refuses: bool) -> Self {
        Self {
            chips: CfiFlash::new(Bank(()), EmbassyClock, BLOCKS),
            refuses,
        }
    }

    /// Asks the chips what they are.
    ///
    /// # Errors
    /// [`CfiError::Absent`] or [`CfiError::Geometry`].
    pub fn probe(&mut self) -> Result<(), CfiError> {
        self.chips.probe()
    }

    /// Fills both ends of each block with noise, as flash that another program used.
    ///
    /// # Errors
    /// Those of the chips.
    pub async fn scribble(&mut self, rng: &mut impl Rng) -> Result<(), CfiError> {
        self.chips.erase(0, u32::from(BLOCKS) * ERASE_BLOCK).await?;
        for block in 0..u32::from(BLOCKS) {
            let start = block * ERASE_BLOCK;
            for part in [start, start + ERASE_BLOCK - NOISE] {
                for at in (part..part + NOISE).step_by(WORD as usize) {
                    self.chips.write(at, &rng.next_u32().to_le_bytes()).await?;
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
        self.chips.read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.chips.capacity()
    }
}

impl NorFlash for ParameterFlash {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = ERASE_BLOCK as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), CfiError> {
        if self.refuses {
            return Err(CfiError::Refused(REFUSAL));
        }
        self.chips.erase(from, to).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), CfiError> {
        if self.refuses {
            return Err(CfiError::Refused(REFUSAL));
        }
        self.chips.write(offset, bytes).await
    }
}
