//! A body whose devices say what is on an event log.

use core::convert::Infallible;
use std::cell::RefCell;
use std::future::pending;
use std::rc::Rc;

use crawler_hal::{
    Adc, Camera, FrameFormat, LinkMonitor, LinkState, Millivolts, MotorPort, NetError, Network,
    Parts, RangerPort, ResetCause, System,
};
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use embedded_storage_async::nor_flash::{self, NorFlash, ReadNorFlash};

use super::life::Life;
use super::playback::{Playback, failed};
use super::{Flash, Lens, Output, What, Writer};
use crate::devices::{
    CAMERA_SIDE, Chip, DutyError, FlashError, GaugeError, LensError, MAX_DUTY, SimFlash, UartError,
};
use crate::run::journal::Payload;
use crate::run::machine::{Either, EitherBody};
use crate::sched::SimClock;
use crate::world::Wiring;

/// The body that a program of this life starts on.
pub(crate) fn parts(life: &Life, playback: &Rc<Playback>, clock: &SimClock) -> Parts<EitherBody> {
    use Output::{Lamp, LeftDuty, LeftIn1, LeftIn2, RightDuty, RightIn1, RightIn2};
    let line = || Line(Rc::clone(playback));
    let output = |output| Played {
        output,
        playback: Rc::clone(playback),
    };
    let motor = |outputs: [Output; 3]| MotorPort {
        enable: Either::Played(output(outputs[0])),
        in1: Either::Played(output(outputs[1])),
        in2: Either::Played(output(outputs[2])),
    };
    let chip = Rc::new(RefCell::new(Chip::of_image(
        life.flash.iter().map(Payload::bytes),
    )));
    Parts {
        clock: clock.boot_now(),
        left: motor([LeftDuty, LeftIn1, LeftIn2]),
        right: motor([RightDuty, RightIn1, RightIn2]),
        ranger: match life.wiring {
            Wiring::Uart => RangerPort::Uart(Either::Played(line())),
            Wiring::Pulse => RangerPort::Pulse {
                trigger: Either::Played(line()),
                echo: Either::Played(line()),
            },
        },
        lamp: Either::Played(output(Lamp)),
        battery: Either::Played(line()),
        camera: Either::Played(line()),
        flash: Either::Played(PlayedFlash {
            inner: SimFlash::open(&chip),
            playback: Rc::clone(playback),
        }),
        slots: None,
        network: Either::Played(line()),
        system: Either::Played(PlayedSystem {
            cause: life.cause(),
            panic: life.panic.clone(),
            playback: Rc::clone(playback),
        }),
        rng: life.rng.clone(),
    }
}

/// An output that leads nowhere.
#[derive(Debug)]
pub(crate) struct Played {
    output: Output,
    playback: Rc<Playback>,
}

impl pwm::ErrorType for Played {
    type Error = DutyError;
}

impl SetDutyCycle for Played {
    fn max_duty_cycle(&self) -> u16 {
        MAX_DUTY
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Self::Error> {
        let duty = u8::try_from(duty).map_err(|_| DutyError)?;
        self.playback.event_log.set(self.output, duty);
        Ok(())
    }
}

impl digital::ErrorType for Played {
    type Error = Infallible;
}

impl OutputPin for Played {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.playback.event_log.set(self.output, 0);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.playback.event_log.set(self.output, 1);
        Ok(())
    }
}

/// A device that says its lines: the ranger by line or by pins, the battery, the camera, the
/// network.
#[derive(Debug)]
pub(crate) struct Line(Rc<Playback>);

impl ErrorType for Line {
    type Error = UartError;
}

impl Read for Line {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, UartError> {
        if buf.is_empty() {
            return Ok(0);
        }
        let taken = self.0.bytes(buf, |script| &mut script.heard).await;
        taken.ok_or(UartError)
    }
}

impl Write for Line {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, UartError> {
        let begun = self.0.event_log.now();
        let taken = self.0.take(Writer::Ask, buf.len()).await;
        let asked = What::Asked {
            bytes: Payload::new(&buf[..if taken.broken { 0 } else { taken.bytes }]),
            done_us: None,
            broken: taken.broken,
        };
        self.0.event_log.note_at(begun, asked);
        if taken.broken {
            Err(UartError)
        } else {
            Ok(taken.bytes)
        }
    }

    async fn flush(&mut self) -> Result<(), UartError> {
        self.0.take(Writer::Flush, 0).await;
        Ok(())
    }
}

impl digital::ErrorType for Line {
    type Error = Infallible;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.event_log.note(What::Trigger(false));
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.event_log.note(What::Trigger(true));
        Ok(())
    }
}

impl InputPin for Line {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.echo_level())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.echo_level())
    }
}

impl Line {
    async fn edge(&self) -> Result<(), Infallible> {
        self.0.next(|script| &mut script.echo).await;
        Ok(())
    }
}

impl Wait for Line {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.edge().await
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.edge().await
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.edge().await
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        self.edge().await
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.edge().await
    }
}

impl Adc for Line {
    type Error = GaugeError;

    async fn read(&mut self) -> Result<Millivolts, GaugeError> {
        let said = self.0.next(|script| &mut script.battery).await;
        said.map(Millivolts).ok_or(GaugeError)
    }
}

fn lens(error: Lens) -> LensError {
    match error {
        Lens::Length => LensError::Length,
        Lens::TooLarge => LensError::TooLarge,
        Lens::Absent => LensError::Absent,
        Lens::Disconnected => LensError::Disconnected,
    }
}

impl Line {
    async fn picture(&self, buffer: &mut [u8]) -> Result<usize, LensError> {
        let picture = self.0.next(|script| &mut script.picture).await;
        let picture = picture.map_err(lens)?;
        let target = buffer.get_mut(..picture.len()).ok_or(LensError::TooLarge)?;
        target.copy_from_slice(&picture);
        Ok(picture.len())
    }
}

impl Camera for Line {
    type Error = LensError;

    fn size(&self) -> (u16, u16) {
        (CAMERA_SIDE, CAMERA_SIDE)
    }

    fn format(&self) -> FrameFormat {
        FrameFormat::Rgb565
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), LensError> {
        self.picture(frame).await.map(|_| ())
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, LensError> {
        self.picture(jpeg).await
    }
}

/// A flash with the contents it had, that refuses what it refused.
#[derive(Debug)]
pub(crate) struct PlayedFlash {
    inner: SimFlash,
    playback: Rc<Playback>,
}

impl PlayedFlash {
    fn admit(&self) -> Result<(), FlashError> {
        match self
            .playback
            .refuses(self.playback.event_log.flash_operation())
        {
            None => Ok(()),
            Some(Flash::NotAligned) => Err(FlashError::NotAligned),
            Some(Flash::OutOfBounds) => Err(FlashError::OutOfBounds),
            Some(Flash::NotErased) => Err(FlashError::NotErased),
            Some(Flash::PowerLost) => Err(FlashError::PowerLost),
        }
    }
}

impl nor_flash::ErrorType for PlayedFlash {
    type Error = FlashError;
}

impl ReadNorFlash for PlayedFlash {
    const READ_SIZE: usize = SimFlash::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.admit()?;
        self.inner.read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.inner.capacity()
    }
}

impl NorFlash for PlayedFlash {
    const WRITE_SIZE: usize = SimFlash::WRITE_SIZE;
    const ERASE_SIZE: usize = SimFlash::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.admit()?;
        self.inner.erase(from, to).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.admit()?;
        self.inner.write(offset, bytes).await
    }
}

/// A microcontroller that started for the reason it had.
#[derive(Debug)]
pub(crate) struct PlayedSystem {
    cause: ResetCause,
    panic: Option<String>,
    playback: Rc<Playback>,
}

impl System for PlayedSystem {
    fn reset_cause(&self) -> ResetCause {
        self.cause
    }

    fn last_panic(&self) -> Option<&str> {
        self.panic.as_deref()
    }

    fn feed_watchdog(&mut self) {
        self.playback.event_log.look();
    }

    async fn reset(&mut self) -> Infallible {
        self.playback.event_log.note(What::Reset);
        pending().await
    }
}

/// The radio's word, as it was.
#[derive(Debug, Clone)]
pub(crate) struct PlayedMonitor(Rc<Playback>);

impl LinkMonitor for PlayedMonitor {
    fn state(&self) -> LinkState {
        self.0.link()
    }
}

/// A connection over which comes what came.
#[derive(Debug)]
pub(crate) struct PlayedStream(Rc<Playback>);

impl Network for Line {
    type Stream<'a> = PlayedStream;
    type Monitor = PlayedMonitor;

    fn monitor(&self) -> PlayedMonitor {
        PlayedMonitor(Rc::clone(&self.0))
    }

    async fn join(&mut self) -> Result<(), NetError> {
        failed(self.0.next(|script| &mut script.joined).await)
    }

    async fn connect(&mut self, _host: &str, _port: u16) -> Result<PlayedStream, NetError> {
        failed(self.0.next(|script| &mut script.connected).await)?;
        self.0.event_log.connected();
        Ok(PlayedStream(Rc::clone(&self.0)))
    }
}

/// What was wrong with a connection is not recorded, and nothing depends on it.
const BROKEN: ErrorKind = ErrorKind::ConnectionReset;

impl ErrorType for PlayedStream {
    type Error = ErrorKind;
}

impl Read for PlayedStream {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, ErrorKind> {
        if buf.is_empty() {
            return Ok(0);
        }
        let taken = self.0.bytes(buf, |script| &mut script.received).await;
        taken.ok_or(BROKEN)
    }
}

impl Write for PlayedStream {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, ErrorKind> {
        let begun = self.0.event_log.now();
        let taken = self.0.take(Writer::Send, buf.len()).await;
        if taken.broken {
            return Err(BROKEN);
        }
        self.0.event_log.sent(begun, &buf[..taken.bytes]);
        Ok(taken.bytes)
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}
