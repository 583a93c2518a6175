//! Time as something handed in.

use embassy_futures::select::{Either, select};

use crate::{Duration, Instant};

/// A body's monotonic clock.
///
/// A handle: cheap to clone, and every clone tells the same time. On a board it is embassy-time;
/// in the simulator it is the world's own virtual clock.
pub trait Clock: Clone {
    /// The present moment. Never goes back.
    fn now(&self) -> Instant;

    /// Returns at `at`, or at once when `at` is past. Never returns early.
    ///
    /// # Cancellation Safety
    /// Dropping the future has no effect beyond no longer waiting.
    async fn sleep_until(&self, at: Instant);

    /// Returns after `span`.
    ///
    /// # Cancellation Safety
    /// As [`Clock::sleep_until`].
    async fn sleep(&self, span: Duration) {
        self.sleep_until(self.now() + span).await;
    }
}

/// A deadline passed first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Elapsed;

/// Runs `work` until `deadline`.
///
/// # Errors
/// [`Elapsed`] when `deadline` passes first; `work` is then dropped.
///
/// # Cancellation Safety
/// As safe as `work` itself.
pub async fn with_deadline<C: Clock, F: Future>(
    clock: &C,
    deadline: Instant,
    work: F,
) -> Result<F::Output, Elapsed> {
    match select(work, clock.sleep_until(deadline)).await {
        Either::First(done) => Ok(done),
        Either::Second(()) => Err(Elapsed),
    }
}

/// A steady beat that does not drift: each tick is a period after the one before it.
///
/// When the owner falls behind by more than a period, the missed ticks are skipped rather than
/// delivered in a burst.
#[derive(Debug)]
pub struct Ticker {
    period: Duration,
    next: Instant,
}

impl Ticker {
    /// A beat of `period` whose first tick is one period after `now`.
    #[must_use]
    pub fn every(period: Duration, now: Instant) -> Self {
        Self {
            period,
            next: now + period,
        }
    }

    /// Returns at the next tick, with the moment the tick was due.
    ///
    /// # Cancellation Safety
    /// A dropped call loses no tick.
    pub async fn tick<C: Clock>(&mut self, clock: &C) -> Instant {
        clock.sleep_until(self.next).await;
        self.go_on(clock.now())
    }

    /// As [`Ticker::tick`], so much after the tick, or after now when the owner has fallen behind. The next tick comes
    /// when it would have come.
    ///
    /// # Cancellation Safety
    /// A dropped call loses no tick.
    pub async fn tick_late<C: Clock>(&mut self, clock: &C, late: Duration) -> Instant {
        clock.sleep_until(self.next.max(clock.now()) + late).await;
        self.go_on(clock.now())
    }

    fn go_on(&mut self, now: Instant) -> Instant {
        let due = self.next;
        self.next += self.period;
        if self.next < now {
            self.next = now + self.period;
        }
        due
    }
}
