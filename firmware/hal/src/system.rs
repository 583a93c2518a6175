//! The microcontroller itself.

use core::convert::Infallible;

/// Why the program started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ResetCause {
    /// Power was switched on.
    PowerOn,
    /// The program asked for it.
    Software,
    /// The watchdog was not fed.
    Watchdog,
    /// The supply voltage fell too low.
    BrownOut,
    /// The program panicked.
    Panic,
    /// The reset pin, or a cause the chip does not name.
    External,
}

/// Reset and watchdog.
pub trait System {
    /// Why the program started.
    fn reset_cause(&self) -> ResetCause;

    /// Tells the watchdog that the control loop is healthy.
    fn feed_watchdog(&mut self);

    /// Restarts the program. The future never completes.
    async fn reset(&mut self) -> Infallible;
}
