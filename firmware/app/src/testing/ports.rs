//! Ports whose other side the test holds.

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use std::collections::VecDeque;
use std::rc::Rc;

use crawler_hal::{Adc, Clock, Duration, Instant, Millivolts, MotorPort, ResetCause, System};
use embedded_hal::digital::{self, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_io_async::{ErrorType, Read, Write};

use super::TestClock;

/// What the program did to one output.
#[derive(Clone, Default)]
pub(crate) struct Line {
    pub(crate) level: Rc<Cell<u16>>,
    pub(crate) refuses: Rc<Cell<bool>>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Refused;

impl digital::Error for Refused {
    fn kind(&self) -> digital::ErrorKind {
        digital::ErrorKind::Other
    }
}

impl pwm::Error for Refused {
    fn kind(&self) -> pwm::ErrorKind {
        pwm::ErrorKind::Other
    }
}

impl Line {
    fn set(&self, level: u16) -> Result<(), Refused> {
        if self.refuses.get() {
            return Err(Refused);
        }
        self.level.set(level);
        Ok(())
    }
}

impl digital::ErrorType for Line {
    type Error = Refused;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), Refused> {
        self.set(0)
    }

    fn set_high(&mut self) -> Result<(), Refused> {
        self.set(1)
    }
}

impl pwm::ErrorType for Line {
    type Error = Refused;
}

impl SetDutyCycle for Line {
    fn max_duty_cycle(&self) -> u16 {
        255
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Refused> {
        self.set(duty)
    }
}

/// Both sides of one motor.
#[derive(Clone, Default)]
pub(crate) struct Motor {
    pub(crate) enable: Line,
    pub(crate) in1: Line,
    pub(crate) in2: Line,
}

impl Motor {
    pub(crate) fn port(&self) -> MotorPort<Line, Line> {
        MotorPort {
            enable: self.enable.clone(),
            in1: self.in1.clone(),
            in2: self.in2.clone(),
        }
    }

    /// Duty at the pins, −1 to 1.
    pub(crate) fn duty(&self) -> f32 {
        let duty = f32::from(self.enable.level.get()) / 255.0;
        match (self.in1.level.get(), self.in2.level.get()) {
            (1, 0) => duty,
            (0, 1) => -duty,
            _ => 0.0,
        }
    }
}

/// A US-100 on a UART: answers 30 ms after it was asked. Like that of the real one, its last digit
/// is never at rest.
#[derive(Clone)]
pub(crate) struct Ranger {
    clock: TestClock,
    pub(crate) range_mm: Rc<Cell<u16>>,
    pub(crate) silent: Rc<Cell<bool>>,
    odd: Rc<Cell<bool>>,
    replies: Rc<RefCell<VecDeque<(Instant, u8)>>>,
}

impl Ranger {
    pub(crate) fn new(clock: TestClock, range_mm: u16) -> Self {
        Self {
            clock,
            range_mm: Rc::new(Cell::new(range_mm)),
            silent: Rc::default(),
            odd: Rc::default(),
            replies: Rc::default(),
        }
    }
}

impl ErrorType for Ranger {
    type Error = embedded_io_async::ErrorKind;
}

impl Write for Ranger {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        let due = self.clock.now() + Duration::from_millis(30);
        if !self.silent.get() {
            let mut replies = self.replies.borrow_mut();
            for byte in bytes {
                match byte {
                    0x55 => {
                        let odd = u16::from(self.odd.replace(!self.odd.get()));
                        let range = self.range_mm.get() + odd;
                        replies.extend(range.to_be_bytes().map(|byte| (due, byte)));
                    }
                    0x50 => replies.push_back((due, 21 + 45)),
                    other => panic!("the sensor knows no request {other:#x}"),
                }
            }
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

impl Read for Ranger {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        let next = self.replies.borrow().front().copied();
        let Some((due, byte)) = next else {
            return core::future::pending().await;
        };
        self.clock.sleep_until(due).await;
        self.replies.borrow_mut().pop_front();
        buffer[0] = byte;
        Ok(1)
    }
}

/// Trigger and echo that are not wired.
pub(crate) struct NotWired;

impl digital::ErrorType for NotWired {
    type Error = Refused;
}

impl digital::InputPin for NotWired {
    fn is_high(&mut self) -> Result<bool, Refused> {
        Err(Refused)
    }

    fn is_low(&mut self) -> Result<bool, Refused> {
        Err(Refused)
    }
}

impl embedded_hal_async::digital::Wait for NotWired {
    async fn wait_for_high(&mut self) -> Result<(), Refused> {
        Err(Refused)
    }

    async fn wait_for_low(&mut self) -> Result<(), Refused> {
        Err(Refused)
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Refused> {
        Err(Refused)
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Refused> {
        Err(Refused)
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Refused> {
        Err(Refused)
    }
}

/// The microcontroller: counts what is done to it.
#[derive(Clone, Default)]
pub(crate) struct Chip {
    pub(crate) feeds: Rc<Cell<u32>>,
    pub(crate) resets: Rc<Cell<u32>>,
}

impl System for Chip {
    fn reset_cause(&self) -> ResetCause {
        ResetCause::PowerOn
    }

    fn last_panic(&self) -> Option<&str> {
        None
    }

    fn feed_watchdog(&mut self) {
        self.feeds.set(self.feeds.get() + 1);
    }

    async fn reset(&mut self) -> Infallible {
        self.resets.set(self.resets.get() + 1);
        core::future::pending().await
    }
}

/// The battery pin; `None` fails.
#[derive(Clone, Default)]
pub(crate) struct BatteryPin(pub(crate) Rc<Cell<Option<Millivolts>>>);

impl Adc for BatteryPin {
    type Error = ();

    async fn read(&mut self) -> Result<Millivolts, ()> {
        self.0.get().ok_or(())
    }
}
