//! A flash that is not written while the supply may give way.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

use crate::context::Robot;

/// Why the guarded flash did not do something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum GuardError<E> {
    /// The battery is too low to write or erase.
    LowVoltage,
    /// The flash itself.
    Flash(E),
}

impl<E: NorFlashError> NorFlashError for GuardError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::LowVoltage => NorFlashErrorKind::Other,
            Self::Flash(error) => error.kind(),
        }
    }
}

/// Sits below the map, so that its repairs are guarded too.
pub(super) struct Guarded<'a, M: RawMutex, F> {
    flash: F,
    robot: &'a Robot<M>,
}

impl<'a, M: RawMutex, F> Guarded<'a, M, F> {
    pub(super) const fn new(flash: F, robot: &'a Robot<M>) -> Self {
        Self { flash, robot }
    }

    fn check<E>(&self) -> Result<(), GuardError<E>> {
        if self.robot.battery().brown_out {
            Err(GuardError::LowVoltage)
        } else {
            Ok(())
        }
    }
}

impl<M: RawMutex, F: NorFlash> ErrorType for Guarded<'_, M, F> {
    type Error = GuardError<F::Error>;
}

impl<M: RawMutex, F: NorFlash> ReadNorFlash for Guarded<'_, M, F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let done = self.flash.read(offset, bytes).await;
        done.map_err(GuardError::Flash)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<M: RawMutex, F: NorFlash> NorFlash for Guarded<'_, M, F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.check()?;
        let done = self.flash.erase(from, to).await;
        done.map_err(GuardError::Flash)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.check()?;
        let done = self.flash.write(offset, bytes).await;
        done.map_err(GuardError::Flash)
    }
}
