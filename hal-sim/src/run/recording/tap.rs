//! Devices that tell a tape what passes through them, and change nothing about it.
//!
//! A tap polls the device inside it and nothing else, so that a recorded history is the same as
//! one that is not.

mod network;
mod ranger;

use core::convert::Infallible;
use core::marker::PhantomData;
use std::rc::Rc;

use crawler_hal::{
    Adc, Body, Camera, FrameFormat, Millivolts, MotorPort, Network, Parts, RangerPort, ResetCause,
    System,
};
use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_storage_async::nor_flash::{self, MultiwriteNorFlash, NorFlash, ReadNorFlash};
use rand_pcg::Pcg32;

use super::tape::{Flash, Lens, Output, Tape, What, Writer, millivolts};
use crate::devices::{
    FlashError, LensError, SimBody, SimCamera, SimEcho, SimFlash, SimGauge, SimPin, SimPwm,
    SimSystem, SimTrigger, SimUart,
};
use crate::run::journal::Payload;
use crate::sched::SimClock;

/// A device and the tape it tells.
#[derive(Debug)]
pub(crate) struct Tap<D> {
    inner: D,
    tape: Rc<Tape>,
}

impl<D> Tap<D> {
    fn new(inner: D, tape: &Rc<Tape>) -> Self {
        Self {
            inner,
            tape: Rc::clone(tape),
        }
    }
}

/// Something that a device was given and has not taken yet. Dropped before it is over, it is
/// noted as given up.
struct Attempt<'a> {
    tape: &'a Tape,
    writer: Writer,
    begun: u64,
    over: bool,
}

impl<'a> Attempt<'a> {
    fn new(tape: &'a Tape, writer: Writer) -> Self {
        Self {
            tape,
            writer,
            begun: tape.now(),
            over: false,
        }
    }

    fn over(mut self) {
        self.over = true;
    }
}

impl Drop for Attempt<'_> {
    fn drop(&mut self) {
        if !self.over {
            self.tape.note_at(self.begun, What::GivenUp(self.writer));
        }
    }
}

/// An output whose place is known.
#[derive(Debug)]
pub(crate) struct Wired<D> {
    inner: D,
    output: Output,
    tape: Rc<Tape>,
}

/// A simulated body with a tap on every device.
#[derive(Debug)]
pub(crate) struct TappedBody<N>(PhantomData<N>);

impl<N: Network> Body for TappedBody<N> {
    type Clock = SimClock;
    type Pwm = Wired<SimPwm>;
    type Pin = Wired<SimPin>;
    type Uart = Tap<SimUart>;
    type Trigger = Tap<SimTrigger>;
    type Echo = Tap<SimEcho>;
    type Battery = Tap<SimGauge>;
    type Camera = Tap<SimCamera>;
    type Flash = Tap<SimFlash>;
    type Network = Tap<N>;
    type System = Tap<SimSystem>;
    type Rng = Pcg32;
}

/// Puts a tap on every device of a body.
pub(crate) fn tap<N: Network>(parts: Parts<SimBody<N>>, tape: &Rc<Tape>) -> Parts<TappedBody<N>> {
    use Output::{Lamp, LeftDuty, LeftIn1, LeftIn2, RightDuty, RightIn1, RightIn2};
    let motor = |port: MotorPort<SimPwm, SimPin>, outputs: [Output; 3]| MotorPort {
        enable: wired(port.enable, outputs[0], tape),
        in1: wired(port.in1, outputs[1], tape),
        in2: wired(port.in2, outputs[2], tape),
    };
    Parts {
        clock: parts.clock,
        left: motor(parts.left, [LeftDuty, LeftIn1, LeftIn2]),
        right: motor(parts.right, [RightDuty, RightIn1, RightIn2]),
        ranger: match parts.ranger {
            RangerPort::Uart(uart) => RangerPort::Uart(Tap::new(uart, tape)),
            RangerPort::Pulse { trigger, echo } => RangerPort::Pulse {
                trigger: Tap::new(trigger, tape),
                echo: Tap::new(echo, tape),
            },
        },
        lamp: wired(parts.lamp, Lamp, tape),
        battery: Tap::new(parts.battery, tape),
        camera: Tap::new(parts.camera, tape),
        flash: Tap::new(parts.flash, tape),
        network: Tap::new(parts.network, tape),
        system: Tap::new(parts.system, tape),
        rng: parts.rng,
    }
}

fn wired<D>(inner: D, output: Output, tape: &Rc<Tape>) -> Wired<D> {
    Wired {
        inner,
        output,
        tape: Rc::clone(tape),
    }
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
        self.tape.set(self.output, duty.min(255) as u8);
        Ok(())
    }
}

impl<D: digital::ErrorType> digital::ErrorType for Wired<D> {
    type Error = D::Error;
}

impl<D: OutputPin> OutputPin for Wired<D> {
    fn set_low(&mut self) -> Result<(), D::Error> {
        self.inner.set_low()?;
        self.tape.set(self.output, 0);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), D::Error> {
        self.inner.set_high()?;
        self.tape.set(self.output, 1);
        Ok(())
    }
}

impl<D: Adc> Adc for Tap<D> {
    type Error = D::Error;

    async fn read(&mut self) -> Result<Millivolts, D::Error> {
        let result = self.inner.read().await;
        self.tape.note(What::Battery(millivolts(&result)));
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
        let picture = result.map(|()| Payload::new(frame)).map_err(lens);
        self.tape.note(What::Picture(picture));
        result
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, LensError> {
        let result = self.inner.still(jpeg).await;
        let picture = result.map(|length| Payload::new(jpeg.get(..length).unwrap_or(jpeg)));
        self.tape.note(What::Picture(picture.map_err(lens)));
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
        self.tape.look();
        self.inner.feed_watchdog();
    }

    async fn reset(&mut self) -> Infallible {
        self.tape.note(What::Reset);
        self.inner.reset().await
    }
}

impl Tap<SimFlash> {
    /// Operations take no time and mostly succeed; what they read is known from what was written.
    fn noted<T>(&self, number: u64, result: Result<T, FlashError>) -> Result<T, FlashError> {
        if let Err(error) = &result {
            let refused = match error {
                FlashError::NotAligned => Flash::NotAligned,
                FlashError::OutOfBounds => Flash::OutOfBounds,
                FlashError::NotErased => Flash::NotErased,
                FlashError::PowerLost => Flash::PowerLost,
            };
            self.tape.note(What::FlashRefused(number, refused));
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
        let number = self.tape.flash_operation();
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
        let number = self.tape.flash_operation();
        let result = self.inner.erase(from, to).await;
        self.noted(number, result)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let number = self.tape.flash_operation();
        let result = self.inner.write(offset, bytes).await;
        self.noted(number, result)
    }
}

impl MultiwriteNorFlash for Tap<SimFlash> {}
