//! The controller's end of the wires.

use core::convert::Infallible;
use core::future::pending;

use crawler_hal::{Adc, Clock, Millivolts};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorType, Read, Write};

use super::{BYTE_TIME, Bench, LineFault, World};

/// A half of the bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The motor on the left.
    Left,
    /// The motor on the right.
    Right,
}

/// What an output pin is wired to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Line {
    /// IN1 or IN3.
    In1(Side),
    /// IN2 or IN4.
    In2(Side),
    /// The lamp.
    Lamp,
}

/// An enable input of the bridge on a PWM channel.
#[derive(Debug)]
pub struct ModelPwm<'b, M: RawMutex> {
    bench: &'b Bench<M>,
    side: Side,
}

/// An output pin.
#[derive(Debug)]
pub struct ModelPin<'b, M: RawMutex> {
    bench: &'b Bench<M>,
    line: Line,
}

/// The middle of the battery's divider, on a converter.
#[derive(Debug)]
pub struct ModelAdc<'b, M: RawMutex> {
    bench: &'b Bench<M>,
}

/// The serial line to the ranger.
#[derive(Debug)]
pub struct ModelUart<'b, M: RawMutex, C> {
    bench: &'b Bench<M>,
    clock: C,
}

/// A pin that this body does not have. There is no value of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelEcho {}

/// The duty is above [`ModelPwm::max_duty_cycle`]. The channel keeps what it had.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DutyError;

/// Nothing is wired there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotWired {}

impl<M: RawMutex> Bench<M> {
    /// The enable input of one side.
    pub const fn pwm(&self, side: Side) -> ModelPwm<'_, M> {
        ModelPwm { bench: self, side }
    }

    /// The pin at `line`.
    pub const fn pin(&self, line: Line) -> ModelPin<'_, M> {
        ModelPin { bench: self, line }
    }

    /// The input of the battery gauge.
    pub const fn gauge(&self) -> ModelAdc<'_, M> {
        ModelAdc { bench: self }
    }

    /// The line to the ranger.
    pub const fn uart<C: Clock>(&self, clock: C) -> ModelUart<'_, M, C> {
        ModelUart { bench: self, clock }
    }
}

impl pwm::Error for DutyError {
    fn kind(&self) -> pwm::ErrorKind {
        pwm::ErrorKind::Other
    }
}

impl<M: RawMutex> pwm::ErrorType for ModelPwm<'_, M> {
    type Error = DutyError;
}

impl<M: RawMutex> SetDutyCycle for ModelPwm<'_, M> {
    fn max_duty_cycle(&self) -> u16 {
        u8::MAX.into()
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), DutyError> {
        let duty = u8::try_from(duty).map_err(|_| DutyError)?;
        self.bench
            .drive_pins(|levels| levels.bridges[self.side as usize].duty = duty);
        Ok(())
    }
}

impl<M: RawMutex> ModelPin<'_, M> {
    fn set(&self, level: bool) {
        self.bench.drive_pins(|levels| match self.line {
            Line::In1(side) => levels.bridges[side as usize].in1 = level,
            Line::In2(side) => levels.bridges[side as usize].in2 = level,
            Line::Lamp => levels.lamp = level,
        });
    }
}

impl<M: RawMutex> digital::ErrorType for ModelPin<'_, M> {
    type Error = Infallible;
}

impl<M: RawMutex> OutputPin for ModelPin<'_, M> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

impl digital::Error for NotWired {
    fn kind(&self) -> digital::ErrorKind {
        match *self {}
    }
}

impl digital::ErrorType for ModelEcho {
    type Error = NotWired;
}

impl OutputPin for ModelEcho {
    fn set_low(&mut self) -> Result<(), NotWired> {
        match *self {}
    }

    fn set_high(&mut self) -> Result<(), NotWired> {
        match *self {}
    }
}

impl InputPin for ModelEcho {
    fn is_high(&mut self) -> Result<bool, NotWired> {
        match *self {}
    }

    fn is_low(&mut self) -> Result<bool, NotWired> {
        match *self {}
    }
}

impl Wait for ModelEcho {
    async fn wait_for_high(&mut self) -> Result<(), NotWired> {
        match *self {}
    }

    async fn wait_for_low(&mut self) -> Result<(), NotWired> {
        match *self {}
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), NotWired> {
        match *self {}
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), NotWired> {
        match *self {}
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), NotWired> {
        match *self {}
    }
}

impl<M: RawMutex> Adc for ModelAdc<'_, M> {
    type Error = Infallible;

    async fn read(&mut self) -> Result<Millivolts, Infallible> {
        let told = self.bench.with_world(|world| {
            let World { drive, rng, .. } = world;
            drive.gauge_mv(rng)
        });
        Ok(Millivolts(told))
    }
}

impl<M: RawMutex, C> ErrorType for ModelUart<'_, M, C> {
    type Error = Infallible;
}

impl<M: RawMutex, C: Clock> Read for ModelUart<'_, M, C> {
    /// Waits for at least one byte. Nothing can arrive unless something was written before, so
    /// with nothing under way this waits for ever.
    ///
    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Infallible> {
        if buf.is_empty() {
            return Ok(0);
        }
        if self.bench.fault == LineFault::Stuck {
            // A receiver takes a line held low for zeros, with framing errors nobody looks at.
            self.clock.sleep(BYTE_TIME).await;
            buf[0] = 0;
            return Ok(1);
        }
        let arrival = self.bench.with_world(|world| world.sensor.next_arrival());
        let Some(arrival) = arrival else {
            return pending().await;
        };
        self.clock.sleep_until(arrival).await;
        let now = self.clock.now();
        Ok(self.bench.with_world(|world| world.sensor.take(buf, now)))
    }
}

impl<M: RawMutex, C: Clock> Write for ModelUart<'_, M, C> {
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Infallible> {
        let Some(byte) = buf.first() else {
            return Ok(0);
        };
        // The transmitter holds one byte.
        self.flush().await?;
        let now = self.clock.now();
        self.bench.with_world(|world| {
            let arrives = now + BYTE_TIME;
            let World {
                drive, sensor, rng, ..
            } = world;
            sensor.sent_until = arrives;
            if self.bench.fault == LineFault::None {
                sensor.hear(*byte, arrives, drive, rng);
            }
        });
        Ok(1)
    }

    /// Waits until the last byte has left.
    ///
    /// # Cancellation Safety
    /// A dropped call has no effect.
    async fn flush(&mut self) -> Result<(), Infallible> {
        let until = self.bench.with_world(|world| world.sensor.sent_until);
        self.clock.sleep_until(until).await;
        Ok(())
    }
}
