//! Reading the entries from a flash, and bringing them to a goal.

use embedded_storage::nor_flash::{MultiwriteNorFlash, ReadNorFlash};
use embedded_storage_async::nor_flash::{
    MultiwriteNorFlash as AsyncMultiwriteNorFlash, ReadNorFlash as AsyncReadNorFlash,
};

use super::{Entry, Goal, Otadata, PlanError, Slots};
use crate::flash::{FlashError, SECTOR};

/// No goal takes more: an entry to give up, one to adopt, and one to write, each with its erase.
const STEPS: usize = 12;

impl Otadata {
    /// Reads the entries of the partition that begins at `base` of `flash`.
    ///
    /// # Errors
    /// That of the flash.
    pub fn read<F: ReadNorFlash>(flash: &mut F, base: u32, slots: Slots) -> Result<Self, F::Error> {
        let mut entries = [[0; Entry::BYTES]; 2];
        for (at, entry) in [base, base + SECTOR].into_iter().zip(&mut entries) {
            flash.read(at, entry)?;
        }
        Ok(Self::new(entries.map(Entry::from_bytes), slots))
    }

    /// As [`Otadata::read`], where the flash is waited for.
    ///
    /// # Errors
    /// That of the flash.
    ///
    /// # Cancellation Safety
    /// Reads only.
    pub async fn read_async<F: AsyncReadNorFlash>(
        flash: &mut F,
        base: u32,
        slots: Slots,
    ) -> Result<Self, F::Error> {
        let mut entries = [[0; Entry::BYTES]; 2];
        for (at, entry) in [base, base + SECTOR].into_iter().zip(&mut entries) {
            flash.read(at, entry).await?;
        }
        Ok(Self::new(entries.map(Entry::from_bytes), slots))
    }

    /// Does all that leads to `goal`, and reads back that it is reached.
    ///
    /// # Errors
    /// [`FlashError::Refused`] with a [`PlanError`] when there is no way.
    pub fn reach<F: MultiwriteNorFlash>(
        flash: &mut F,
        base: u32,
        slots: Slots,
        goal: Goal,
    ) -> Result<Self, FlashError<F::Error, PlanError>> {
        for _ in 0..STEPS {
            let present = Self::read(flash, base, slots).map_err(FlashError::Flash)?;
            match present.toward(goal).map_err(FlashError::Refused)? {
                None => return Ok(present),
                Some(operation) => operation.execute(flash, base).map_err(FlashError::Flash)?,
            }
        }
        Err(FlashError::Worn)
    }

    /// As [`Otadata::reach`], where the flash is waited for.
    ///
    /// # Errors
    /// As [`Otadata::reach`].
    ///
    /// # Cancellation Safety
    /// As safe as a power cut: begin again.
    pub async fn reach_async<F: AsyncMultiwriteNorFlash>(
        flash: &mut F,
        base: u32,
        slots: Slots,
        goal: Goal,
    ) -> Result<Self, FlashError<F::Error, PlanError>> {
        for _ in 0..STEPS {
            let present = Self::read_async(flash, base, slots)
                .await
                .map_err(FlashError::Flash)?;
            match present.toward(goal).map_err(FlashError::Refused)? {
                None => return Ok(present),
                Some(operation) => {
                    let done = operation.execute_async(flash, base).await;
                    done.map_err(FlashError::Flash)?;
                }
            }
        }
        Err(FlashError::Worn)
    }
}
