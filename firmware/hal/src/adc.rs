//! Analogue input.

use crate::Millivolts;

/// One analogue input pin. `embedded-hal` 1.0 has no trait for it.
pub trait Adc {
    /// Why a conversion failed.
    type Error: core::fmt::Debug;

    /// Measures the voltage at the pin, calibrated.
    ///
    /// # Errors
    /// When the converter does not answer or is not calibrated.
    async fn read(&mut self) -> Result<Millivolts, Self::Error>;
}

impl<T: Adc> Adc for &mut T {
    type Error = T::Error;

    async fn read(&mut self) -> Result<Millivolts, Self::Error> {
        T::read(self).await
    }
}
