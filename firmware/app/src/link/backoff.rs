//! How long to wait before the next attempt.

use crawler_hal::Duration;
use rand_core::Rng;

/// First wait after a session that was stable, or after boot.
pub const SHORTEST: Duration = Duration::from_millis(500);
/// Longest wait while the broker cannot be reached: with what connecting takes, a robot is back within
/// ten seconds of its broker.
pub const LONGEST: Duration = Duration::from_secs(6);
/// Longest wait after the broker refused the session.
pub const REFUSED: Duration = Duration::from_secs(30);
/// A session that lasted this long was stable: the next wait is short again. Longer than
/// [`LONGEST`], so that two robots with one id do not each find the other's absence stable.
pub const STABLE_AFTER: Duration = Duration::from_secs(60);
/// Sessions in a row that opened at the first attempt and were soon closed by the broker, after
/// which a second robot with this id is suspected. Not every broker says so.
pub const SUSPICIOUS: u8 = 3;
/// First wait after another robot with this robot's id has taken the session over.
pub const TAKEN_OVER: Duration = Duration::from_secs(60);
/// Longest wait while that keeps happening.
pub const TAKEN_OVER_LONGEST: Duration = Duration::from_secs(600);

/// Exponential back-off with jitter: each wait is drawn from the upper half of a span that doubles
/// from one failure to the next, so that a fleet that lost its broker in one moment does not come
/// back in one moment.
#[derive(Debug)]
pub(super) struct Backoff {
    span: Duration,
    taken_over: Duration,
    /// Sessions that were soon closed, in a row.
    closed: u8,
}

impl Backoff {
    pub(super) const fn new() -> Self {
        Self {
            span: SHORTEST,
            taken_over: TAKEN_OVER,
            closed: 0,
        }
    }

    /// The wait after an attempt that failed, or a session that was lost after `lasted`.
    pub(super) fn after_loss(&mut self, lasted: Duration, rng: &mut impl Rng) -> Duration {
        self.taken_over = TAKEN_OVER;
        self.closed = 0;
        self.doubled(lasted, rng)
    }

    /// The wait after the broker closed a session that had lasted for `lasted`.
    pub(super) fn after_close(&mut self, lasted: Duration, rng: &mut impl Rng) -> Duration {
        self.taken_over = TAKEN_OVER;
        self.closed = if lasted < STABLE_AFTER {
            self.closed.saturating_add(1)
        } else {
            0
        };
        if self.suspects_double() {
            return jittered(TAKEN_OVER, rng);
        }
        self.doubled(lasted, rng)
    }

    /// The broker has forgotten the session that was to go on: it has started anew, and that is what closed the
    /// sessions so far. With a double it would have known one, the double's.
    pub(super) const fn session_forgotten(&mut self) {
        self.closed = 0;
    }

    /// Whether it looks as if another robot had this robot's id.
    pub(super) const fn suspects_double(&self) -> bool {
        self.closed >= SUSPICIOUS
    }

    fn doubled(&mut self, lasted: Duration, rng: &mut impl Rng) -> Duration {
        if lasted >= STABLE_AFTER {
            self.span = SHORTEST;
        }
        let wait = jittered(self.span, rng);
        self.span = (self.span * 2).min(LONGEST);
        wait
    }

    /// The wait after the broker refused the session for a reason that time alone seldom mends.
    pub(super) fn after_refusal(&mut self, rng: &mut impl Rng) -> Duration {
        self.taken_over = TAKEN_OVER;
        self.closed = 0;
        self.span = LONGEST;
        jittered(REFUSED, rng)
    }

    /// The wait after another client with the same id appeared. Were it short, two robots with
    /// one id would throw each other out for ever.
    pub(super) fn after_takeover(&mut self, rng: &mut impl Rng) -> Duration {
        self.span = SHORTEST;
        self.closed = 0;
        let wait = jittered(self.taken_over, rng);
        self.taken_over = (self.taken_over * 2).min(TAKEN_OVER_LONGEST);
        wait
    }
}

/// Between half of `span` and all of it.
fn jittered(span: Duration, rng: &mut impl Rng) -> Duration {
    let half = span.as_micros() / 2;
    // Spans stay far below 2^32 µs · 2, so the product fits.
    let extra = (half * u64::from(rng.next_u32())) >> 32;
    Duration::from_micros(half + extra)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers every draw with the same number.
    struct Fixed(u32);

    impl rand_core::TryRng for Fixed {
        type Error = core::convert::Infallible;

        fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
            Ok(self.0)
        }

        fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
            Ok(u64::from(self.0))
        }

        fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
            bytes.fill(self.0 as u8);
            Ok(())
        }
    }

    #[test]
    fn waits_double_up_to_the_longest_and_fall_back_after_a_stable_session() {
        let mut backoff = Backoff::new();
        let mut rng = Fixed(u32::MAX);
        let mut expected = SHORTEST;
        for _ in 0..12 {
            let wait = backoff.after_loss(Duration::ZERO, &mut rng);
            assert!(wait <= expected, "{wait:?} after a span of {expected:?}");
            assert!(wait.as_micros() + 2 >= expected.as_micros());
            expected = (expected * 2).min(LONGEST);
        }
        assert_eq!(expected, LONGEST);
        assert!(backoff.after_loss(STABLE_AFTER, &mut rng) <= SHORTEST);
    }

    #[test]
    fn jitter_spreads_waits_over_the_upper_half() {
        let low = Backoff::new().after_loss(Duration::ZERO, &mut Fixed(0));
        let high = Backoff::new().after_loss(Duration::ZERO, &mut Fixed(u32::MAX));
        assert_eq!(low.as_micros() * 2, SHORTEST.as_micros());
        assert!(high > low && high <= SHORTEST);
    }

    #[test]
    fn sessions_closed_soon_again_and_again_make_a_second_robot_suspected() {
        let mut backoff = Backoff::new();
        let mut rng = Fixed(0);
        let soon = Duration::from_secs(5);
        for _ in 1..SUSPICIOUS {
            assert!(backoff.after_close(soon, &mut rng) < Duration::from_secs(2));
            assert!(!backoff.suspects_double());
        }
        let wait = backoff.after_close(soon, &mut rng);
        assert!(backoff.suspects_double());
        assert_eq!(wait.as_micros() * 2, TAKEN_OVER.as_micros());
        // A broker that could not be reached in between was restarted, not shared.
        backoff.after_loss(Duration::ZERO, &mut rng);
        assert!(!backoff.suspects_double());
        for _ in 0..4 * SUSPICIOUS {
            // And so was one that knows no session any more.
            backoff.session_forgotten();
            assert!(backoff.after_close(soon, &mut rng) < LONGEST);
            assert!(!backoff.suspects_double());
        }
        backoff.session_forgotten();
        backoff.after_close(soon, &mut rng);
        backoff.after_close(soon, &mut rng);
        backoff.after_close(STABLE_AFTER, &mut rng);
        backoff.after_close(soon, &mut rng);
        assert!(!backoff.suspects_double());
    }

    #[test]
    fn a_robot_thrown_out_again_and_again_waits_longer_each_time() {
        let mut backoff = Backoff::new();
        let mut rng = Fixed(0);
        let mut last = Duration::ZERO;
        for _ in 0..8 {
            let wait = backoff.after_takeover(&mut rng);
            assert!(wait >= last && wait <= TAKEN_OVER_LONGEST);
            assert!(wait.as_micros() >= TAKEN_OVER.as_micros() / 2);
            last = wait;
        }
        assert_eq!(last.as_micros() * 2, TAKEN_OVER_LONGEST.as_micros());
        backoff.after_loss(Duration::ZERO, &mut rng);
        assert_eq!(
            backoff.after_takeover(&mut rng).as_micros() * 2,
            TAKEN_OVER.as_micros()
        );
    }
}
