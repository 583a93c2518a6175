//! What programs hold of a chip.

use core::future::pending;
use std::cell::RefCell;
use std::rc::Rc;

use crawler_hal::{Clock as _, Duration, ResetCause};
use embedded_storage::nor_flash as blocking;
use embedded_storage_async::nor_flash::{ErrorType, MultiwriteNorFlash, NorFlash, ReadNorFlash};

use super::timing::{self, PAGE_BYTES};
use super::{Chip, ERASE_BYTES, FlashError, Operation, Region, WRITE_BYTES};
use crate::devices::ports::Wire;
use crate::sched::SimClock;

/// A connection to a chip, which a reset or a power cut ends.
#[derive(Debug)]
struct Connection {
    chip: Rc<RefCell<Chip>>,
    session: u32,
    /// The body that resets when the power goes; none outside of a world.
    wire: Option<Wire>,
}

impl Connection {
    fn open(chip: &Rc<RefCell<Chip>>, wire: Option<Wire>) -> Self {
        Self {
            session: chip.borrow().session,
            chip: Rc::clone(chip),
            wire,
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

/// A program's way to the parameters in a [`Chip`].
///
/// Operations take no time: the program waits for them as it does on a chip that shares its bus
/// with the code.
#[derive(Debug)]
pub struct SimFlash(Connection);

impl SimFlash {
    /// Opens a chip.
    pub fn open(chip: &Rc<RefCell<Chip>>) -> Self {
        Self(Connection::open(chip, None))
    }

    /// See [`Chip::image`].
    #[cfg(feature = "recording")]
    pub(crate) fn image(&self) -> Vec<Vec<u8>> {
        self.0.chip.borrow().image()
    }

    pub(crate) fn of_body(wire: &Wire) -> Self {
        Self(Connection::open(&wire.ports.chip, Some(wire.clone())))
    }
}

impl ErrorType for SimFlash {
    type Error = FlashError;
}

impl ReadNorFlash for SimFlash {
    const READ_SIZE: usize = WRITE_BYTES;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.0
            .run(|chip| chip.read(Region::Parameters, offset, bytes))
    }

    fn capacity(&self) -> usize {
        self.0.chip.borrow().capacity(Region::Parameters)
    }
}

impl NorFlash for SimFlash {
    const WRITE_SIZE: usize = WRITE_BYTES;
    const ERASE_SIZE: usize = ERASE_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.0.run(|chip| chip.erase(Region::Parameters, from, to))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.0
            .run(|chip| chip.write(Region::Parameters, offset, bytes))
    }
}

// The chips of these boards allow it: a second write may clear more bits.
impl MultiwriteNorFlash for SimFlash {}

/// A program's way to its slots and select entries in a [`Chip`], see [`super::SLOTS`].
///
/// Programming and erasing take time, page by page and block by block, and change the memory when that is
/// over. Everything else of the robot goes on meanwhile, as on a chip that is written while code runs from
/// elsewhere. Reading takes none. An operation whose future is dropped comes to its end by itself, and the
/// next one waits for that; a power cut tears it, and its future never ends.
#[derive(Debug)]
pub struct SimSlots {
    connection: Connection,
    clock: SimClock,
}

impl SimSlots {
    /// Opens a chip that is outside of any world, in the time of `clock`.
    pub fn open(chip: &Rc<RefCell<Chip>>, clock: &SimClock) -> Self {
        Self {
            connection: Connection::open(chip, None),
            clock: clock.world(),
        }
    }

    pub(crate) fn of_body(wire: &Wire) -> Self {
        Self {
            connection: Connection::open(&wire.ports.chip, Some(wire.clone())),
            clock: wire.clock().world(),
        }
    }

    /// In a world a program hears nothing of the power going: it has none either.
    async fn run<R>(
        &self,
        operation: impl FnOnce(&mut Chip) -> Result<R, FlashError>,
    ) -> Result<R, FlashError> {
        let result = self.connection.run(operation);
        if matches!(result, Err(FlashError::PowerLost)) && self.connection.wire.is_some() {
            pending::<()>().await;
        }
        result
    }

    /// Waits until the chip has done what it was told before.
    async fn ready(&self) -> Result<(), FlashError> {
        while let Some(until) = self.run(|chip| Ok(chip.busy_until())).await? {
            self.clock.sleep_until(until).await;
            self.run(Chip::settle).await?;
        }
        Ok(())
    }

    async fn operate(&self, what: Operation, time: Duration) -> Result<(), FlashError> {
        let until = self.clock.now() + time;
        self.run(|chip| {
            chip.begin(what, until);
            Ok(())
        })
        .await?;
        self.ready().await
    }
}

impl ErrorType for SimSlots {
    type Error = FlashError;
}

impl ReadNorFlash for SimSlots {
    const READ_SIZE: usize = WRITE_BYTES;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.ready().await?;
        self.run(|chip| chip.read(Region::Slots, offset, bytes))
            .await
    }

    fn capacity(&self) -> usize {
        self.connection.chip.borrow().capacity(Region::Slots)
    }
}

impl NorFlash for SimSlots {
    const WRITE_SIZE: usize = WRITE_BYTES;
    const ERASE_SIZE: usize = ERASE_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.ready().await?;
        self.run(|chip| chip.check_erase(Region::Slots, from, to))
            .await?;
        let mut from = from;
        while from < to {
            let (bytes, time) = timing::erase(from, to);
            let what = Operation::Erase {
                from,
                to: from + bytes,
            };
            self.operate(what, time).await?;
            from += bytes;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.ready().await?;
        self.run(|chip| chip.check_write(Region::Slots, offset, bytes))
            .await?;
        let (mut at, mut rest) = (offset, bytes);
        while !rest.is_empty() {
            let room = PAGE_BYTES - at as usize % PAGE_BYTES;
            let (page, behind) = rest.split_at(rest.len().min(room));
            let what = Operation::Program {
                at,
                bytes: page.to_vec(),
            };
            self.operate(what, timing::program(page.len())).await?;
            at += page.len() as u32;
            rest = behind;
        }
        Ok(())
    }
}

impl MultiwriteNorFlash for SimSlots {}

/// What is in charge of the slots before a program starts, and waits for the chip without anybody else
/// being there to notice.
#[derive(Debug)]
pub(in crate::devices) struct BootFlash<'a>(pub(in crate::devices) &'a mut Chip);

impl BootFlash<'_> {
    fn run<R>(
        &mut self,
        operation: impl FnOnce(&mut Chip) -> Result<R, FlashError>,
    ) -> Result<R, FlashError> {
        if self.0.powered {
            operation(self.0)
        } else {
            Err(FlashError::PowerLost)
        }
    }
}

impl ErrorType for BootFlash<'_> {
    type Error = FlashError;
}

impl blocking::ReadNorFlash for BootFlash<'_> {
    const READ_SIZE: usize = WRITE_BYTES;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.run(|chip| chip.read(Region::Slots, offset, bytes))
    }

    fn capacity(&self) -> usize {
        self.0.capacity(Region::Slots)
    }
}

impl blocking::NorFlash for BootFlash<'_> {
    const WRITE_SIZE: usize = WRITE_BYTES;
    const ERASE_SIZE: usize = ERASE_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.run(|chip| chip.erase(Region::Slots, from, to))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.run(|chip| chip.write(Region::Slots, offset, bytes))
    }
}

impl blocking::MultiwriteNorFlash for BootFlash<'_> {}
