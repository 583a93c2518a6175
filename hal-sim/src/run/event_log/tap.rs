//! Devices that tell an event log what passes through them, and change nothing about it.
//!
//! A tap polls the device inside it and nothing else, so that a recorded history is the same as
//! one that is not. Every device has one, with an event log or without: a program over devices without
//! would be compiled once more.

mod network;
mod ranger;

use core::convert::Infallible;
use std::rc::Rc;

use crawler_hal::{
    Adc, Camera, FrameFormat, Millivolts, MotorPort, Parts, RangerPort, ResetCause, System,
};
use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_storage_async::nor_flash::{self, NorFlash, ReadNorFlash};

use super::{EventLog, Flash, Lens, Output, What, Writer, millivolts};
use crate::devices::{
    FlashError, LensError, SimBody, SimCamera, SimFlash, SimPin, SimPwm, SimSystem,
};
use crate::net::network::SimNetwork;
use crate::run::journal::Payload;
use crate::run::machine::{Either, EitherBody};

/// A device and the event log it tells, if any.
#[derive(Debug)]
pub(crate) struct Tap<D> {
    inner: D,
    event_log: Option<Rc<EventLog>>,
}

impl<D> Tap<D> {
    fn note(&self, what: impl FnOnce() -> What) {
        if let Some(event_log) = &self.event_log {
            event_log.note(what());
        }
    }
}

/// Something that a device was given and has not taken yet. Dropped before it is over, it is
/// noted as given up.
struct Attempt<'a> {
    event_log: &'a EventLog,
    writer: Writer,
    begun: u64,
    over: bool,
}

impl<'a> Attempt<'a> {
    /// `None` where there is no event log.
    fn new(event_log: Option<&'a Rc<EventLog>>, writer: Writer) -> Option<Self> {
        event_log.map(|event_log| Self {
            event_log,
            writer,
            begun: event_log.now(),
            over: false,
        })
    }

    /// It was not given up: hands out the event log, and when the attempt began.
    fn over(mut self) -> (&'a EventLog, u64) {
        self.over = true;
        (self.event_log, self.begun)
    }
}

impl Drop for Attempt<'_> {
    fn drop(&mut self) {
        if !self.over {
            self.event_log
                .note_at(self.begun, What::GivenUp(self.writer));
        }
    }
}

/// An output whose place is known.
#[derive(Debug)]
pub(crate) struct Wired<D> {
    inner: D,
    output: Output,
    event_log: Option<Rc<EventLog>>,
}

impl<D> Wired<D> {
    fn note(&self, value: u8) {
        if let Some(event_log) = &self.event_log {
            event_log.set(self.output, value);
        }
    }
}

/// Puts a tap on every device of a body, off where there is no event log.
pub(crate) fn tap(
    parts: Parts<SimBody<SimNetwork>>,
    event_log: Option<&Rc<EventLog>>,
) -> Parts<EitherBody> {
    use Output::{Lamp, LeftDuty, LeftIn1, LeftIn2, RightDuty, RightIn1, RightIn2};
    let motor = |port: MotorPort<SimPwm, SimPin>, outputs: [Output; 3]| MotorPort {
        enable: wired(port.enable, outputs[0], event_log),
        in1: wired(port.in1, outputs[1], event_log),
        in2: wired(port.in2, outputs[2], event_log),
    };
    Parts {
        clock: parts.clock,
        left: motor(parts.left, [LeftDuty, LeftIn1, LeftIn2]),
        right: motor(parts.right, [RightDuty, RightIn1, RightIn2]),
        ranger: match parts.ranger {
            RangerPort::Uart(uart) => RangerPort::Uart(tapped(uart, event_log)),
            RangerPort::Pulse { trigger, echo } => RangerPort::Pulse {
                trigger: tapped(trigger, event_log),
                echo: tapped(echo, event_log),
            },
        },
        lamp: wired(parts.lamp, Lamp, event_log),
        battery: tapped(parts.battery, event_log),
        camera: tapped(parts.camera, event_log),
        flash: tapped(parts.flash, event_log),
        slots: parts.slots,
        network: tapped(parts.network, event_log),
        system: tapped(parts.system, event_log),
        rng: parts.rng,
    }
}

fn tapped<D, P>(inner: D, event_log: Option<&Rc<EventLog>>) -> Either<Tap<D>, P> {
    Either::Simulated(Tap {
        inner,
        event_log: event_log.cloned(),
    })
}

fn wired<D, P>(inner: D, output: Output, event_log: Option<&Rc<EventLog>>) -> Either<Wired<D>, P> {
    Either::Simulated(Wired {
        inner,
        output,
        event_log: event_log.cloned(),
    })
}

impl<D: pwm::ErrorType> pwm::ErrorType for Wired<D> {
    type Error = D::Error;
}

impl<D: SetDutyCycle> SetDutyCycle for Wired<D> {
    fn max_duty_cycle(&self) -> u16 {
        self.inner.max_duty_cycle()
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), D::Error> {
        self.inner.set_duty_cycle(duty)?;
        self.note(duty.min(255) as u8);
        Ok(())
    }
}

impl<D: digital::ErrorType> digital::ErrorType for Wired<D> {
    type Error = D::Error;
}

impl<D: OutputPin> OutputPin for Wired<D> {
    fn set_low(&mut self) -> Result<(), D::Error> {
        self.inner.set_low()?;
        self.note(0);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), D::Error> {
        self.inner.set_high()?;
        self.note(1);
        Ok(())
    }
}

impl<D: Adc> Adc for Tap<D> {
    type Error = D::Error;

    async fn read(&mut self) -> Result<Millivolts, D::Error> {
        let result = self.inner.read().await;
        self.note(|| What::Battery(millivolts(&result)));
        result
    }
}

fn lens(error: LensError) -> Lens {
    match error {
        LensError::Length => Lens::Length,
        LensError::TooLarge => Lens::TooLarge,
        LensError::Absent => Lens::Absent,
        LensError::Disconnected => Lens::Disconnected,
    }
}

impl Camera for Tap<SimCamera> {
    type Error = LensError;

    fn size(&self) -> (u16, u16) {
        self.inner.size()
    }

    fn format(&self) -> FrameFormat {
        self.inner.format()
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), LensError> {
        let result = self.inner.capture(frame).await;
        self.note(|| What::Picture(result.map(|()| Payload::new(frame)).map_err(lens)));
        result
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, LensError> {
        let result = self.inner.still(jpeg).await;
        self.note(|| {
            let picture = result.map(|length| Payload::new(jpeg.get(..length).unwrap_or(jpeg)));
            What::Picture(picture.map_err(lens))
        });
        result
    }
}

impl System for Tap<SimSystem> {
    fn reset_cause(&self) -> ResetCause {
        self.inner.reset_cause()
    }

    fn last_panic(&self) -> Option<&str> {
        self.inner.last_panic()
    }

    fn feed_watchdog(&mut self) {
        if let Some(event_log) = &self.event_log {
            event_log.look();
        }
        self.inner.feed_watchdog();
    }

    async fn reset(&mut self) -> Infallible {
        self.note(|| What::Reset);
        self.inner.reset().await
    }
}

impl Tap<SimFlash> {
    /// The number of the operation that begins; none where nobody counts.
    fn operation(&self) -> Option<u64> {
        self.event_log
            .as_ref()
            .map(|event_log| event_log.flash_operation())
    }

    /// Operations take no time and mostly succeed; what they read is known from what was written.
    fn noted<T>(
        &self,
        number: Option<u64>,
        result: Result<T, FlashError>,
    ) -> Result<T, FlashError> {
        if let (Err(error), Some(number)) = (&result, number) {
            let refused = match error {
                FlashError::NotAligned => Flash::NotAligned,
                FlashError::OutOfBounds => Flash::OutOfBounds,
                FlashError::NotErased => Flash::NotErased,
                FlashError::PowerLost => Flash::PowerLost,
            };
            self.note(|| What::FlashRefused(number, refused));
        }
        result
    }
}

impl nor_flash::ErrorType for Tap<SimFlash> {
    type Error = FlashError;
}

impl ReadNorFlash for Tap<SimFlash> {
    const READ_SIZE: usize = SimFlash::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let number = self.operation();
        let result = self.inner.read(offset, bytes).await;
        self.noted(number, result)
    }

    fn capacity(&self) -> usize {
        self.inner.capacity()
    }
}

impl NorFlash for Tap<SimFlash> {
    const WRITE_SIZE: usize = SimFlash::WRITE_SIZE;
    const ERASE_SIZE: usize = SimFlash::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let number = self.operation();
        let result = self.inner.erase(from, to).await;
        self.noted(number, result)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let number = self.operation();
        let result = self.inner.write(offset, bytes).await;
        self.noted(number, result)
    }
}
