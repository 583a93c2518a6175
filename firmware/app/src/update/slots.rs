//! The flash with both slots, as an update uses it.

use crawler_boot::RollbackReason;
use crawler_boot::flash::{FlashError, SECTOR, WORD};
use crawler_boot::otadata::{Goal, Otadata, PlanError, Slots as Count, Standing};
use crawler_boot::trailer::{Begin, ENVELOPE_AT, Record, Trailer};
use crawler_hal::{SlotPort, SlotRegion};
use crawler_release::ENVELOPE_MAX;
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::Updates;
use super::transfer::Failed;

/// Bytes that are read, hashed or written between two looks at whatever else there is to do: 16,896
/// instructions of SHA-256, a tenth of a millisecond.
pub(super) const SLICE: usize = 256;

/// Which of the two slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slot {
    /// The one whose program runs.
    Running,
    /// The other one.
    Spare,
}

/// See the [module](self).
pub(super) struct Slots<F> {
    port: SlotPort<F>,
}

impl<F: MultiwriteNorFlash> Slots<F> {
    /// `None` for a port that says what cannot be.
    pub(super) fn new(port: SlotPort<F>) -> Option<Self> {
        let fits = |region: &SlotRegion| {
            region.start.is_multiple_of(SECTOR)
                && region.length.is_multiple_of(SECTOR)
                && region.length >= 2 * SECTOR
                && region.start.checked_add(region.length).is_some()
        };
        let usable = port.running < 2
            && port.otadata.is_multiple_of(SECTOR)
            && port.slots.iter().all(fits)
            && WORD.is_multiple_of(F::WRITE_SIZE)
            && SLICE.is_multiple_of(F::READ_SIZE);
        usable.then_some(Self { port })
    }

    pub(super) const fn chip(&self) -> u16 {
        self.port.chip
    }

    fn region(&self, slot: Slot) -> SlotRegion {
        let running = usize::from(self.port.running);
        match slot {
            Slot::Running => self.port.slots[running],
            Slot::Spare => self.port.slots[1 - running],
        }
    }

    /// Bytes that the spare slot has for an image.
    pub(super) fn capacity(&self) -> u32 {
        self.region(Slot::Spare).length - SECTOR
    }

    fn trailer_at(&self, slot: Slot) -> u32 {
        let region = self.region(slot);
        region.start + region.length - SECTOR
    }

    /// What otadata says of the running program.
    pub(super) async fn standing(&mut self) -> Result<Standing, Failed> {
        let read = Otadata::read_async(&mut self.port.flash, self.port.otadata, Count::TWO).await;
        let otadata = read.map_err(|_| Failed::Flash)?;
        Ok(otadata.standing(self.port.running))
    }

    async fn reach(&mut self, goal: Goal) -> Result<(), FlashError<F::Error, PlanError>> {
        let (flash, at) = (&mut self.port.flash, self.port.otadata);
        Otadata::reach_async(flash, at, Count::TWO, goal).await?;
        Ok(())
    }

    /// Has otadata name the running program as the one that is proven.
    pub(super) async fn keep(&mut self) -> Result<(), Failed> {
        let running = self.port.running;
        let kept = self.reach(Goal::Keep { running }).await;
        kept.map_err(|_| Failed::Flash)
    }

    /// Has the spare slot started next, on trial.
    pub(super) async fn activate(&mut self) -> Result<(), Failed> {
        self.record(Slot::Spare, Record::Activated).await?;
        let running = self.port.running;
        let slot = 1 - running;
        let activated = self.reach(Goal::Activate { slot, running }).await;
        activated.map_err(|_| Failed::Flash)
    }

    /// Notes that the running program is proven: first where it decides what is started.
    pub(super) async fn confirm(&mut self, with_trailer: bool) -> Result<(), Failed> {
        let running = self.port.running;
        let confirmed = self.reach(Goal::Confirm { running }).await;
        confirmed.map_err(|_| Failed::Flash)?;
        if with_trailer {
            self.record(Slot::Running, Record::Confirmed).await?;
        }
        Ok(())
    }

    /// Gives the running program up. Whether there is another one to start.
    pub(super) async fn give_up(&mut self, why: RollbackReason) -> bool {
        // Without a trailer, or with a worn one, the reason is lost; the way back is not.
        let _ = self.record(Slot::Running, Record::RolledBack(why)).await;
        let running = self.port.running;
        let given_up = self.reach(Goal::GiveUp { running }).await;
        !matches!(given_up, Err(FlashError::Refused(_)))
    }

    pub(super) async fn trailer(&mut self, slot: Slot) -> Result<Trailer, Failed> {
        let at = self.trailer_at(slot);
        let read = Trailer::read_async(&mut self.port.flash, at).await;
        read.map_err(|_| Failed::Flash)
    }

    pub(super) async fn record(&mut self, slot: Slot, record: Record) -> Result<(), Failed> {
        let at = self.trailer_at(slot);
        let written = Trailer::record_async(&mut self.port.flash, at, record).await;
        written.map(|_| ()).map_err(|_| Failed::Flash)
    }

    /// Copies the envelope of a trailer to where chunks arrive; its length.
    pub(super) async fn load<M: RawMutex>(
        &mut self,
        slot: Slot,
        trailer: &Trailer,
        to: &Updates<M>,
    ) -> Result<Option<usize>, Failed> {
        let Some(length) = trailer.envelope().map(usize::from) else {
            return Ok(None);
        };
        let from = self.trailer_at(slot) + ENVELOPE_AT;
        let mut piece = [0; SLICE];
        for at in (0..ENVELOPE_MAX).step_by(SLICE) {
            let read = self.port.flash.read(from + at as u32, &mut piece).await;
            read.map_err(|_| Failed::Flash)?;
            to.copy_in(at, &piece);
        }
        Ok(Some(length))
    }

    /// Begins the spare trailer anew with the envelope of this length that lies where chunks arrive.
    pub(super) async fn begin<M: RawMutex>(
        &mut self,
        length: usize,
        from: &Updates<M>,
    ) -> Result<(), Failed> {
        let at = self.trailer_at(Slot::Spare);
        for index in 0.. {
            let operation = operation(from, length, index);
            let Some(operation) = operation else {
                break;
            };
            let done = operation.execute_async(&mut self.port.flash, at).await;
            done.map_err(|_| Failed::Flash)?;
        }
        let written = self.trailer(Slot::Spare).await?;
        if written.envelope().map(usize::from) == Some(length) && written.blocks() == 0 {
            Ok(())
        } else {
            Err(Failed::Flash)
        }
    }

    /// Erases a sector of the spare slot.
    pub(super) async fn erase(&mut self, sector: u32) -> Result<(), Failed> {
        let at = self.region(Slot::Spare).start + sector * SECTOR;
        if sector * SECTOR >= self.capacity() {
            return Err(Failed::Flash);
        }
        let erased = self.port.flash.erase(at, at + SECTOR).await;
        erased.map_err(|_| Failed::Flash)
    }

    /// Writes the chunk that waits to `at` of the spare slot.
    pub(super) async fn write<M: RawMutex>(
        &mut self,
        at: u32,
        length: usize,
        from: &Updates<M>,
    ) -> Result<(), Failed> {
        let start = self.region(Slot::Spare).start + at;
        for done in (0..length).step_by(SLICE) {
            // Whole words; what is left of the last one programs nothing.
            let mut piece = [0xFF; SLICE];
            let count = (length - done).min(SLICE);
            let (bytes, _) = piece.split_at_mut(count);
            from.copy_out(done, bytes);
            let words = &piece[..count.next_multiple_of(WORD)];
            let written = self.port.flash.write(start + done as u32, words).await;
            written.map_err(|_| Failed::Flash)?;
        }
        Ok(())
    }

    /// Reads `length` bytes of the spare slot from `at` on, a slice at a time, and leaves time for others between
    /// them.
    pub(super) async fn read(
        &mut self,
        at: u32,
        length: u32,
        mut take: impl FnMut(&[u8]),
    ) -> Result<(), Failed> {
        let start = self.region(Slot::Spare).start + at;
        for done in (0..length).step_by(SLICE) {
            let mut piece = [0; SLICE];
            let read = self.port.flash.read(start + done, &mut piece).await;
            read.map_err(|_| Failed::Flash)?;
            let count = ((length - done) as usize).min(SLICE);
            take(&piece[..count]);
            yield_now().await;
        }
        Ok(())
    }
}

/// One operation on the way to a trailer with the envelope that lies where chunks arrive. The envelope is on the stack
/// meanwhile, and not in the future of whoever waits for the flash.
#[inline(never)]
fn operation<M: RawMutex>(
    from: &Updates<M>,
    length: usize,
    index: usize,
) -> Option<crawler_boot::flash::Operation> {
    let mut envelope = [0; ENVELOPE_MAX];
    from.copy_out(0, &mut envelope);
    Begin::new(envelope.get(..length)?).ok()?.nth(index)
}
