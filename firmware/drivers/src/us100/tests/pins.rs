//! A sensor in pulse mode.

use std::cell::RefCell;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;

use crawler_hal::{Clock, Duration, Instant};
use embedded_hal::digital::{Error, ErrorKind, ErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;

use crate::testing::TestClock;

#[derive(Debug)]
struct State {
    clock: TestClock,
    triggered_at: Option<Instant>,
    shortest_trigger: Duration,
    triggers: usize,
    /// Latency and width of every echo to come.
    echo: Option<(Duration, Duration)>,
    high: Option<(Instant, Instant)>,
    touched: usize,
    /// 0: the trigger refuses; 1: reading the echo; 2: waiting for it.
    broken: Option<usize>,
}

impl State {
    fn trigger(&mut self, level: bool) -> Result<(), Refused> {
        self.touched += 1;
        if self.broken == Some(0) {
            return Err(Refused);
        }
        let now = self.clock.now();
        match (self.triggered_at, level) {
            (None, true) => self.triggered_at = Some(now),
            (Some(since), false) => {
                self.triggered_at = None;
                self.triggers += 1;
                self.shortest_trigger = self.shortest_trigger.min(now - since);
                // Shorter than the data sheet asks for: the sensor does not see it.
                if now - since >= Duration::from_micros(10) {
                    self.high = self
                        .echo
                        .map(|(latency, width)| (now + latency, now + latency + width));
                }
            }
            (None, false) | (Some(_), true) => {}
        }
        Ok(())
    }

    fn is_high(&self) -> bool {
        let now = self.clock.now();
        self.high
            .is_some_and(|(rise, fall)| (rise..fall).contains(&now))
    }

    fn poll(&mut self, level: bool) -> Poll<Result<(), Refused>> {
        self.touched += 1;
        if self.broken == Some(2) {
            return Poll::Ready(Err(Refused));
        }
        if self.is_high() == level {
            return Poll::Ready(Ok(()));
        }
        let now = self.clock.now();
        if let Some((rise, fall)) = self.high
            && let Some(change) = [rise, fall].into_iter().find(|&at| at > now)
        {
            self.clock.wake_at(change);
        }
        Poll::Pending
    }
}

/// The sensor.
#[derive(Debug, Clone)]
pub(super) struct Sensor(Rc<RefCell<State>>);

impl Sensor {
    pub(super) fn new(clock: TestClock) -> Self {
        Self(Rc::new(RefCell::new(State {
            clock,
            triggered_at: None,
            shortest_trigger: Duration::from_secs(1),
            triggers: 0,
            echo: None,
            high: None,
            touched: 0,
            broken: None,
        })))
    }

    pub(super) fn pins(&self) -> (Trigger, Echo) {
        (Trigger(self.clone()), Echo(self.clone()))
    }

    pub(super) fn echoes_after(&self, latency: Duration, width: Duration) {
        self.0.borrow_mut().echo = Some((latency, width));
    }

    pub(super) fn break_part(&self, part: usize) {
        self.0.borrow_mut().broken = Some(part);
    }

    pub(super) fn triggers(&self) -> usize {
        self.0.borrow().triggers
    }

    pub(super) fn shortest_trigger(&self) -> Duration {
        self.0.borrow().shortest_trigger
    }

    pub(super) fn touched(&self) -> usize {
        self.0.borrow().touched
    }
}

#[derive(Debug)]
pub(super) struct Refused;

impl Error for Refused {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

#[derive(Debug)]
pub(super) struct Trigger(Sensor);

impl ErrorType for Trigger {
    type Error = Refused;
}

impl OutputPin for Trigger {
    fn set_low(&mut self) -> Result<(), Refused> {
        self.0.0.borrow_mut().trigger(false)
    }
    fn set_high(&mut self) -> Result<(), Refused> {
        self.0.0.borrow_mut().trigger(true)
    }
}

#[derive(Debug)]
pub(super) struct Echo(Sensor);

impl ErrorType for Echo {
    type Error = Refused;
}

impl InputPin for Echo {
    fn is_high(&mut self) -> Result<bool, Refused> {
        let mut state = self.0.0.borrow_mut();
        state.touched += 1;
        if state.broken == Some(1) {
            return Err(Refused);
        }
        Ok(state.is_high())
    }
    fn is_low(&mut self) -> Result<bool, Refused> {
        self.is_high().map(|high| !high)
    }
}

impl Echo {
    async fn wait_for(&mut self, level: bool) -> Result<(), Refused> {
        poll_fn(|_| self.0.0.borrow_mut().poll(level)).await
    }
}

impl Wait for Echo {
    async fn wait_for_high(&mut self) -> Result<(), Refused> {
        self.wait_for(true).await
    }
    async fn wait_for_low(&mut self) -> Result<(), Refused> {
        self.wait_for(false).await
    }
    async fn wait_for_rising_edge(&mut self) -> Result<(), Refused> {
        self.wait_for(false).await?;
        self.wait_for(true).await
    }
    async fn wait_for_falling_edge(&mut self) -> Result<(), Refused> {
        self.wait_for(true).await?;
        self.wait_for(false).await
    }
    async fn wait_for_any_edge(&mut self) -> Result<(), Refused> {
        let level = self.0.0.borrow().is_high();
        self.wait_for(!level).await
    }
}
