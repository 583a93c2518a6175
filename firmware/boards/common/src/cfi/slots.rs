//! The flash of the programs: small sectors on chips with large blocks.

use crawler_boot::flash::SECTOR;
use crawler_hal::Clock;
use crawler_image_format::layout::{END, Group};
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::{ErrorType, MultiwriteNorFlash, NorFlash, ReadNorFlash};

use super::{Bus, CfiError, Rule, SharedChips, WORD, check, write_slices};

/// The address space of the slots ([`crawler_image_format::layout`]): sectors of 4 KiB, of which those of a
/// [`Group`] share an erase block.
///
/// Trailers and select entries are groups by themselves. An image is erased from its front to its end: erasing
/// the first sector of a group erases the group, and the others are blank then. Any other sector that is not blank
/// cannot be erased by itself ([`CfiError::Shared`]).
#[derive(Debug)]
pub struct SlotFlash<'a, M: RawMutex, B, C> {
    chips: &'a SharedChips<M, B, C>,
}

impl<'a, M: RawMutex, B: Bus, C: Clock> SlotFlash<'a, M, B, C> {
    /// The slots on these chips, which somebody probes.
    pub const fn new(chips: &'a SharedChips<M, B, C>) -> Self {
        Self { chips }
    }
}

impl<M: RawMutex, B: Bus, C: Clock> ErrorType for SlotFlash<'_, M, B, C> {
    type Error = CfiError;
}

impl<M: RawMutex, B: Bus, C: Clock> ReadNorFlash for SlotFlash<'_, M, B, C> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), CfiError> {
        let pieces = Group::pieces(offset, bytes.len()).ok_or(CfiError::OutOfBounds)?;
        for piece in pieces {
            let part = bytes.get_mut(piece.from..piece.to);
            let part = part.ok_or(CfiError::OutOfBounds)?;
            self.chips.lock().await.read(piece.offset, part).await?;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        END as usize
    }
}

impl<M: RawMutex, B: Bus, C: Clock> NorFlash for SlotFlash<'_, M, B, C> {
    const WRITE_SIZE: usize = WORD as usize;
    const ERASE_SIZE: usize = SECTOR as usize;

    /// # Cancellation Safety
    /// As safe as a power cut; the next command finds the chips as they are.
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), CfiError> {
        let len = to.checked_sub(from).ok_or(CfiError::OutOfBounds)?;
        check(END, from, len as usize, SECTOR)?;
        let pieces = Group::pieces(from, len as usize).ok_or(CfiError::OutOfBounds)?;
        for piece in pieces {
            let (offset, len) = (piece.offset, (piece.to - piece.from) as u32);
            let group = Group::of(from + piece.from as u32).ok_or(CfiError::OutOfBounds)?;
            let mut chips = self.chips.lock().await;
            if offset == group.block {
                if !chips.is_blank(group.block, group.length).await? {
                    chips.erase_block(group.block).await?;
                }
            } else if !chips.is_blank(offset, len).await? {
                return Err(CfiError::Shared);
            }
            drop(chips);
            yield_now().await;
        }
        Ok(())
    }

    /// # Cancellation Safety
    /// As safe as a power cut; the next command finds the chips as they are.
    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), CfiError> {
        check(END, offset, bytes.len(), WORD)?;
        let pieces = Group::pieces(offset, bytes.len()).ok_or(CfiError::OutOfBounds)?;
        for piece in pieces {
            let part = bytes.get(piece.from..piece.to);
            let part = part.ok_or(CfiError::OutOfBounds)?;
            write_slices(self.chips, piece.offset, part, Rule::ClearBits).await?;
        }
        Ok(())
    }
}

impl<M: RawMutex, B: Bus, C: Clock> MultiwriteNorFlash for SlotFlash<'_, M, B, C> {}
