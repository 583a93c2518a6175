//! The control bus (SCCB), which is I²C without repeated start.

use crawler_hal::{Clock, Duration};
use embedded_hal_async::i2c::I2c;

use super::Error;
use super::registers::{
    ADDRESS, BANK, BANK_SENSOR, COM7, COM7_RESET, Mode, PIDH, PIDL, PRODUCT, Write, common, mode,
};

/// Until the registers may be written again after a reset. The data sheet gives no time; drivers
/// in wide use wait this long.
const RESET_TIME: Duration = Duration::from_millis(10);

#[derive(Debug)]
pub(super) struct Control<B> {
    bus: B,
}

impl<B: I2c> Control<B> {
    pub(super) const fn new(bus: B) -> Self {
        Self { bus }
    }

    /// Product and version number, when the product is ours.
    pub(super) async fn probe(&mut self) -> Result<(u8, u8), Error> {
        self.write(Write(BANK, BANK_SENSOR)).await?;
        let product = self.read(PIDH).await?;
        if product != PRODUCT {
            return Err(Error::Unknown(product));
        }
        let version = self.read(PIDL).await?;
        Ok((product, version))
    }

    /// Finds the sensor, resets it and sets what all modes share.
    pub(super) async fn reset<C: Clock>(&mut self, clock: &C) -> Result<(), Error> {
        self.probe().await?;
        self.write(Write(COM7, COM7_RESET)).await?;
        clock.sleep(RESET_TIME).await;
        for register in common() {
            self.write(register).await?;
        }
        Ok(())
    }

    pub(super) async fn select(&mut self, which: Mode) -> Result<(), Error> {
        for register in mode(which) {
            self.write(register).await?;
        }
        Ok(())
    }

    async fn write(&mut self, Write(register, value): Write) -> Result<(), Error> {
        self.bus
            .write(ADDRESS, &[register, value])
            .await
            .map_err(|_| Error::Absent)
    }

    /// Two transactions: SCCB knows no repeated start, but a 2-phase write followed by a 2-phase
    /// read.
    async fn read(&mut self, register: u8) -> Result<u8, Error> {
        let mut value = [0];
        self.bus
            .write(ADDRESS, &[register])
            .await
            .map_err(|_| Error::Absent)?;
        self.bus
            .read(ADDRESS, &mut value)
            .await
            .map_err(|_| Error::Absent)?;
        Ok(value[0])
    }
}
