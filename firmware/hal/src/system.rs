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

/// Longest text of a panic that a body keeps over a reset, in bytes.
pub const PANIC_TEXT: usize = 96;

/// Reset and watchdog.
pub trait System {
    /// Why the program started.
    fn reset_cause(&self) -> ResetCause;

    /// Where and why the program panicked before this start, as `src/file.rs:12: text` of at most
    /// [`PANIC_TEXT`] bytes, kept over the reset; `None` when it did not, or when nothing was
    /// kept.
    fn last_panic(&self) -> Option<&str>;

    /// Tells the watchdog that the control loop is healthy.
    fn feed_watchdog(&mut self);

    /// Restarts the program. The future never completes.
    async fn reset(&mut self) -> Infallible;
}
