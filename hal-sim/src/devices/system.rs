//! The microcontroller: reset, reset cause, watchdog.

use core::convert::Infallible;
use core::future::pending;

use crawler_hal::{Clock, ResetCause, System};

use super::ports::Wire;

/// The microcontroller of a simulated robot.
///
/// The first feeding arms the watchdog. Starving it is recorded, and the world asks for a reset.
#[derive(Debug)]
pub struct SimSystem {
    wire: Wire,
    cause: ResetCause,
    panic: Option<String>,
}

impl SimSystem {
    /// A second way to its reset.
    pub(crate) fn resetter(&self) -> Resetter {
        Resetter(self.wire.clone())
    }

    pub(crate) fn new(wire: Wire) -> Self {
        Self {
            cause: wire.ports.cause.get(),
            panic: wire.ports.panic.take(),
            wire,
        }
    }
}

impl System for SimSystem {
    fn reset_cause(&self) -> ResetCause {
        self.cause
    }

    fn last_panic(&self) -> Option<&str> {
        self.panic.as_deref()
    }

    fn feed_watchdog(&mut self) {
        if !self.wire.is_live() {
            return;
        }
        let ports = &self.wire.ports;
        let now = self.wire.clock().now();
        let limit_ms = ports
            .shared
            .space
            .borrow()
            .parameters
            .surroundings
            .watchdog_ms;
        // Looks first: a feeding that comes too late is no feeding.
        ports.check_watchdog(now, u64::from(limit_ms) * 1_000);
        let mut watchdog = ports.watchdog.get();
        watchdog.fed = Some(now);
        ports.watchdog.set(watchdog);
    }

    async fn reset(&mut self) -> Infallible {
        if self.wire.is_live() {
            self.wire.ports.ask_reset(ResetCause::Software);
        }
        pending().await
    }
}

/// Resets a robot from within its program, as a program does that fails.
#[derive(Debug, Clone)]
pub(crate) struct Resetter(Wire);

impl Resetter {
    /// The program panics with `text`, as a board's handler notes it.
    pub(crate) fn panic(&self, text: &str) {
        if self.0.is_live() {
            self.0.ports.panic.replace(Some(text.to_owned()));
            self.0.ports.ask_reset(ResetCause::Panic);
        }
    }

    /// The program restarts itself.
    pub(crate) fn restart(&self) {
        if self.0.is_live() {
            self.0.ports.ask_reset(ResetCause::Software);
        }
    }
}
