//! The clock of a robot, over embassy-time.

#[cfg(test)]
pub(crate) mod testing;

use crawler_hal::{Clock, Instant};
use embassy_time::TICK_HZ;

/// Time since boot, as the time driver of the board tells it.
///
/// Ticks are microseconds on every board; another rate does not compile.
#[derive(Debug, Clone, Copy, Default)]
pub struct EmbassyClock;

const _: () = assert!(TICK_HZ == 1_000_000, "ticks are microseconds");

impl Clock for EmbassyClock {
    fn now(&self) -> Instant {
        Instant::from_micros(embassy_time::Instant::now().as_ticks())
    }

    async fn sleep_until(&self, at: Instant) {
        embassy_time::Timer::at(embassy_time::Instant::from_ticks(at.as_micros())).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_hal::Duration;

    #[test]
    fn sleeps_no_shorter_than_asked_and_not_at_all_for_the_past() {
        let clock = EmbassyClock;
        let started = clock.now();
        embassy_futures::block_on(clock.sleep(Duration::from_millis(20)));
        assert!(clock.now() - started >= Duration::from_millis(20));
        embassy_futures::block_on(clock.sleep_until(started));
    }
}
