//! The status lamp, whichever level lights it.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, OutputPin};
use esp_hal::gpio::{AnyPin, Output, OutputConfig};

use crate::board;

/// A lamp that is lit when set high, as the program wants it.
pub(crate) struct Lamp(Output<'static>);

impl Lamp {
    /// A lamp that is dark.
    pub(crate) fn new(pin: impl Into<AnyPin<'static>>) -> Self {
        let dark = !board::LAMP_LIT;
        Self(Output::new(pin.into(), dark, OutputConfig::default()))
    }
}

impl ErrorType for Lamp {
    type Error = Infallible;
}

impl OutputPin for Lamp {
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.set_level(board::LAMP_LIT);
        Ok(())
    }

    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.set_level(!board::LAMP_LIT);
        Ok(())
    }
}
