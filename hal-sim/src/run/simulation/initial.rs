//! The command that a scenario has for every robot, as soon as it can take one.

use crawler_hal::{Duration, Instant};
use crawler_protocol::Action;

/// How often robots are looked at that have not been given it yet.
const PERIOD: Duration = Duration::from_millis(100);

/// The initial command, and who waits for it.
pub(super) struct Initial {
    action: Option<Action>,
    waiting: Vec<u32>,
    due: Instant,
}

impl Initial {
    /// This command, or none.
    pub(super) const fn new(action: Option<Action>) -> Self {
        Self {
            action,
            waiting: Vec::new(),
            due: Instant::FAR_FUTURE,
        }
    }

    /// When robots that wait are looked at; never, when none does.
    pub(super) const fn due(&self) -> Instant {
        self.due
    }

    /// A robot has no command yet at `now`.
    pub(super) fn wait(&mut self, robot: usize, now: Instant) {
        if self.action.is_some() {
            self.waiting.push(robot as u32);
            self.due = self.due.min(next(now));
        }
    }

    /// A robot is there no more.
    pub(super) fn forget(&mut self, robot: usize) {
        self.waiting.retain(|&waiting| waiting as usize != robot);
    }

    /// Nobody gets it any more.
    #[cfg(feature = "live")]
    pub(super) fn end(&mut self) {
        *self = Self::new(None);
    }

    /// The command and those who waited for it; whoever cannot take it yet is to wait again.
    pub(super) fn take(&mut self) -> Option<(Action, Vec<u32>)> {
        self.due = Instant::FAR_FUTURE;
        let action = self.action.clone()?;
        Some((action, std::mem::take(&mut self.waiting)))
    }
}

/// The next moment at which robots are looked at: it must not depend on which others wait.
fn next(now: Instant) -> Instant {
    let period = PERIOD.as_micros();
    Instant::from_micros((now.as_micros() / period + 1) * period)
}
