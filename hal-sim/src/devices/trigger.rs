//! The US-100 with its jumper open: a pulse in, a pulse out.

use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;

use crawler_hal::{Clock, Duration, Instant};
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;

use super::ports::Wire;

/// Shortest trigger pulse the sensor sees (data sheet: at least 10 µs).
const SHORTEST_TRIGGER: Duration = Duration::from_micros(10);

/// From the end of the trigger to the rise of the echo pin: eight cycles of 40 kHz.
pub(crate) const BURST: Duration = Duration::from_micros(200);

/// The trigger input of the sensor.
#[derive(Debug)]
pub struct SimTrigger {
    wire: Wire,
}

impl SimTrigger {
    pub(crate) const fn new(wire: Wire) -> Self {
        Self { wire }
    }
}

impl ErrorType for SimTrigger {
    type Error = Infallible;
}

impl OutputPin for SimTrigger {
    fn set_low(&mut self) -> Result<(), Infallible> {
        if !self.wire.is_live() {
            return Ok(());
        }
        let now = self.wire.clock().now();
        let ports = &self.wire.ports;
        let mut sonar = ports.sonar.borrow_mut();
        let Some(since) = sonar.trigger_since.take() else {
            return Ok(());
        };
        if now - since < SHORTEST_TRIGGER || !sonar.claim(ports, now) {
            return Ok(());
        }
        let echo = sonar.listen(ports, now);
        let rise = now + BURST;
        let fall = rise + echo.after;
        sonar.pulse = Some((rise, fall));
        sonar.occupy(fall);
        if let Some(waker) = sonar.waiting.take() {
            waker.wake();
        }
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        if self.wire.is_live() {
            let now = self.wire.clock().now();
            self.wire
                .ports
                .sonar
                .borrow_mut()
                .trigger_since
                .get_or_insert(now);
        }
        Ok(())
    }
}

/// The echo output of the sensor.
#[derive(Debug)]
pub struct SimEcho {
    wire: Wire,
}

/// The next change of the echo pin.
enum Next {
    /// To this level, at this moment.
    Change(bool, Instant),
    /// None until somebody triggers.
    Nothing,
}

impl SimEcho {
    pub(crate) const fn new(wire: Wire) -> Self {
        Self { wire }
    }

    fn level(&self) -> bool {
        let now = self.wire.clock().now();
        let pulse = self.wire.ports.sonar.borrow().pulse;
        pulse.is_some_and(|(rise, fall)| rise <= now && now < fall)
    }

    fn next(&self) -> Next {
        let now = self.wire.clock().now();
        match self.wire.ports.sonar.borrow().pulse {
            Some((rise, _)) if now < rise => Next::Change(true, rise),
            Some((_, fall)) if now < fall => Next::Change(false, fall),
            Some(_) | None => Next::Nothing,
        }
    }

    /// Waits for the next change of the pin and returns its new level.
    async fn change(&self) -> bool {
        loop {
            if let Next::Change(level, at) = self.next() {
                self.wire.clock().sleep_until(at).await;
                return level;
            }
            poll_fn(|cx| {
                if let Next::Change(..) = self.next() {
                    return Poll::Ready(());
                }
                // One owner, hence one waiter.
                self.wire.ports.sonar.borrow_mut().waiting = Some(cx.waker().clone());
                Poll::Pending
            })
            .await;
        }
    }

    async fn level_becomes(&self, level: bool) {
        if self.level() != level {
            self.edge_to(level).await;
        }
    }

    async fn edge_to(&self, level: bool) {
        while self.change().await != level {}
    }
}

impl ErrorType for SimEcho {
    type Error = Infallible;
}

impl InputPin for SimEcho {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.level())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.level())
    }
}

impl Wait for SimEcho {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.level_becomes(true).await;
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.level_becomes(false).await;
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.edge_to(true).await;
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        self.edge_to(false).await;
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.change().await;
        Ok(())
    }
}
