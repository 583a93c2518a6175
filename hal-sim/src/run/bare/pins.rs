//! Outputs that are nothing but memory, for the motor driver.

use core::convert::Infallible;

use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use serde::{Deserialize, Serialize};

/// An enable input.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct Level(pub(super) u8);

/// A direction input.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct Pin(pub(super) bool);

impl pwm::ErrorType for Level {
    type Error = Infallible;
}

impl SetDutyCycle for Level {
    fn max_duty_cycle(&self) -> u16 {
        u16::from(u8::MAX)
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0 = u8::try_from(duty).unwrap_or(u8::MAX);
        Ok(())
    }
}

impl digital::ErrorType for Pin {
    type Error = Infallible;
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0 = false;
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0 = true;
        Ok(())
    }
}
