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
