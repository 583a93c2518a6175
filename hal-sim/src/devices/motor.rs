//! PWM channels and output pins: the inputs of the L298N, and the lamp.

use core::convert::Infallible;

use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};

use super::ports::Wire;
use crate::world::Bridge;

/// Duty that keeps an enable input high all the time.
pub const MAX_DUTY: u16 = 255;

/// A half of the L298N.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Left,
    Right,
}

/// What an output pin is wired to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Line {
    In1(Side),
    In2(Side),
    Lamp,
}

/// An enable input of the L298N on a PWM channel.
#[derive(Debug)]
pub struct SimPwm {
    wire: Wire,
    side: Side,
}

/// The duty is above [`MAX_DUTY`]. The channel keeps what it had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DutyError;

impl pwm::Error for DutyError {
    fn kind(&self) -> pwm::ErrorKind {
        pwm::ErrorKind::Other
    }
}

impl SimPwm {
    pub(crate) const fn new(wire: Wire, side: Side) -> Self {
        Self { wire, side }
    }
}

impl pwm::ErrorType for SimPwm {
    type Error = DutyError;
}

impl SetDutyCycle for SimPwm {
    fn max_duty_cycle(&self) -> u16 {
        MAX_DUTY
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), DutyError> {
        let duty = u8::try_from(duty).map_err(|_| DutyError)?;
        self.wire
            .drive(|inputs| bridge(inputs, self.side).duty = duty);
        Ok(())
    }
}

/// An output pin.
#[derive(Debug)]
pub struct SimPin {
    wire: Wire,
    line: Line,
}

impl SimPin {
    pub(crate) const fn new(wire: Wire, line: Line) -> Self {
        Self { wire, line }
    }

    fn set(&self, level: bool) {
        self.wire.drive(|inputs| match self.line {
            Line::In1(side) => bridge(inputs, side).in1 = level,
            Line::In2(side) => bridge(inputs, side).in2 = level,
            Line::Lamp => inputs.lamp = level,
        });
    }
}

impl digital::ErrorType for SimPin {
    type Error = Infallible;
}

impl OutputPin for SimPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

fn bridge(inputs: &mut crate::world::Inputs, side: Side) -> &mut Bridge {
    match side {
        Side::Left => &mut inputs.left,
        Side::Right => &mut inputs.right,
    }
}
