//! A board may run activities in an executor of another priority or core: with parts that are
//! `Send`, and a context that locks by critical section, their futures must be `Send` too. Held by
//! the compiler: nothing here is called.
//!
//! Two activities are not, and stay on the executor of their board's main thread: `store`, whose
//! map keeps a trait object without `Sync`, and `link`, whose client reads from a `RefCell`.

use core::convert::Infallible;
use core::future::pending;

use crawler_hal::{
    Adc, Clock, Instant, Millivolts, MotorPort, NoCamera, RangerPort, ResetCause, System,
};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_hal::digital::{ErrorType as PinError, InputPin, OutputPin};
use embedded_hal::pwm::{ErrorType as PwmError, SetDutyCycle};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorType as StreamError, Read, Write};

use crate::testing::TestRng;

type Context = crate::Robot<CriticalSectionRawMutex>;

/// Every device of a board in one.
#[derive(Clone)]
struct Part;

impl Clock for Part {
    fn now(&self) -> Instant {
        Instant::BOOT
    }

    async fn sleep_until(&self, _: Instant) {}
}

impl System for Part {
    fn reset_cause(&self) -> ResetCause {
        ResetCause::PowerOn
    }

    fn last_panic(&self) -> Option<&str> {
        None
    }

    fn feed_watchdog(&mut self) {}

    async fn reset(&mut self) -> Infallible {
        pending().await
    }
}

impl Adc for Part {
    type Error = Infallible;

    async fn read(&mut self) -> Result<Millivolts, Infallible> {
        Ok(Millivolts(0))
    }
}

impl PinError for Part {
    type Error = Infallible;
}

impl OutputPin for Part {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl InputPin for Part {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(false)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Wait for Part {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl PwmError for Part {
    type Error = Infallible;
}

impl SetDutyCycle for Part {
    fn max_duty_cycle(&self) -> u16 {
        1
    }

    fn set_duty_cycle(&mut self, _: u16) -> Result<(), Infallible> {
        Ok(())
    }
}

impl StreamError for Part {
    type Error = Infallible;
}

impl Read for Part {
    async fn read(&mut self, _: &mut [u8]) -> Result<usize, Infallible> {
        Ok(0)
    }
}

impl Write for Part {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

const fn port() -> MotorPort<Part, Part> {
    MotorPort {
        enable: Part,
        in1: Part,
        in2: Part,
    }
}

fn is_send<F: Future + Send>(_: impl FnOnce(&'static Context) -> F) {}

type Slot = crate::ImageSlot<CriticalSectionRawMutex, &'static mut [u8]>;

fn slot() -> &'static Slot {
    unreachable!("nothing here is called")
}

#[test]
fn activities_with_send_parts_are_send() {
    is_send(|robot| crate::control(robot, port(), port(), Part, TestRng(1), Part));
    is_send(|robot| crate::sense(robot, RangerPort::<Part, Part, Part>::Uart(Part), Part));
    is_send(|robot| crate::power(robot, Part, Part));
    is_send(|robot| crate::lamp(robot, Part, Part));
    is_send(|robot| crate::camera(robot, NoCamera, slot(), Part));
}
