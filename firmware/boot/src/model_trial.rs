//! Whether a new model has proven itself, from what is observed of the program that runs it.

use crawler_hal::{Duration, Instant};

use crate::reason::RollbackReason;
use crate::trial::{Observation, Sensors, Trial, Verdict};

/// Looks that a model must have taken before it is confirmed.
pub const LEAST_LOOKS: u32 = 20;
/// How long a model may take for a look: robots that scan take the next one then.
pub const LOOK_WITHIN: Duration = Duration::from_millis(300);

/// What a program sees of itself while it runs a model on trial, at least once per
/// [`MAX_GAP`](crate::trial::MAX_GAP).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelObservation {
    /// Control periods that were missed since the start of the program.
    pub missed: u32,
    /// Sensors that work.
    pub sensors: Sensors,
    /// Looks that the model has taken.
    pub looks: u32,
    /// The longest that it took for one.
    pub slowest: Duration,
}

/// The trial of a model: as a program has to be, everything must be well for
/// [`PROVING`](crate::trial::PROVING), and it must have looked [`LEAST_LOOKS`] times, each within [`LOOK_WITHIN`].
/// Pure: time is handed in.
///
/// The link has no part in it, and a restart ends it: whoever finds a model on trial at the start of the program gives
/// it up.
#[derive(Debug, Clone)]
pub struct ModelTrial(Trial);

impl ModelTrial {
    /// A trial that begins at `now`, with the sensors that worked before.
    #[must_use]
    pub const fn new(now: Instant, before: Sensors) -> Self {
        Self(Trial::new(now, before))
    }

    /// Takes an observation at `now`. A verdict other than [`Verdict::Pending`] is final.
    pub fn observe(&mut self, now: Instant, seen: &ModelObservation) -> Verdict {
        let observed = Observation {
            missed: seen.missed,
            sensors: seen.sensors,
            // What has to have happened once, whatever else is well.
            received: seen.looks >= LEAST_LOOKS,
            delivered: true,
            failed: seen.slowest > LOOK_WITHIN,
        };
        match self.0.observe(now, &observed) {
            Verdict::RollBack(RollbackReason::SelfTest) => {
                Verdict::RollBack(RollbackReason::TooSlow)
            }
            Verdict::RollBack(RollbackReason::NoLink) => Verdict::RollBack(RollbackReason::Timeout),
            verdict => verdict,
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use proptest::prelude::*;

    const WELL: ModelObservation = ModelObservation {
        missed: 3,
        sensors: Sensors::RANGER,
        looks: LEAST_LOOKS,
        slowest: Duration::from_millis(170),
    };

    /// Observes twice a second until there is a verdict; when that is, in milliseconds.
    fn run(mut seen: impl FnMut(u64) -> ModelObservation) -> (u64, Verdict) {
        let mut trial = ModelTrial::new(Instant::from_millis(10_000), Sensors::RANGER);
        for ms in (500..).step_by(500) {
            let verdict = trial.observe(Instant::from_millis(10_000 + ms), &seen(ms));
            if verdict != Verdict::Pending {
                return (ms, verdict);
            }
        }
        unreachable!()
    }

    #[test]
    fn a_model_that_looks_is_confirmed_after_thirty_seconds() {
        // Periods that were missed before are none of its doing.
        assert_eq!(run(|_| WELL), (30_500, Verdict::Confirm));
        let looking = |ms| ModelObservation {
            looks: (ms / 4_000) as u32,
            ..WELL
        };
        assert_eq!(run(looking), (80_000, Verdict::Confirm));
    }

    #[test]
    fn a_model_that_does_not_look_or_is_slow_is_given_up_with_the_reason() {
        let blind = |_| ModelObservation { looks: 0, ..WELL };
        let timeout = Verdict::RollBack(RollbackReason::Timeout);
        assert_eq!(run(blind), (300_000, timeout));
        let slow = |ms| ModelObservation {
            slowest: if ms < 7_000 {
                LOOK_WITHIN
            } else {
                LOOK_WITHIN + Duration::from_micros(1)
            },
            ..WELL
        };
        let too_slow = Verdict::RollBack(RollbackReason::TooSlow);
        assert_eq!(run(slow), (7_000, too_slow));
        let deaf = |_| ModelObservation {
            sensors: Sensors::NONE,
            ..WELL
        };
        let unhealthy = Verdict::RollBack(RollbackReason::UnhealthySensors);
        assert_eq!(run(deaf), (300_000, unhealthy));
        let missing = |ms| ModelObservation {
            missed: (ms / 20_000) as u32,
            ..WELL
        };
        let missed = Verdict::RollBack(RollbackReason::ControlMissed);
        assert_eq!(run(missing), (300_000, missed));
    }

    proptest! {
        #[test]
        fn none_is_confirmed_without_looks_in_time(
            steps in proptest::collection::vec((1_u64..1_500, 0_u32..3, 0_u64..400), 1..300),
        ) {
            let mut trial = ModelTrial::new(Instant::BOOT, Sensors::NONE);
            let (mut now, mut looks, mut slowest) = (0, 0, 0);
            for (gap, more, took) in steps {
                now += gap;
                looks += more;
                slowest = slowest.max(took * u64::from(more > 0));
                let seen = ModelObservation {
                    missed: 0,
                    sensors: Sensors::NONE,
                    looks,
                    slowest: Duration::from_millis(slowest),
                };
                match trial.observe(Instant::from_millis(now), &seen) {
                    Verdict::Pending => prop_assert!(slowest <= 300 && now < 300_000),
                    Verdict::Confirm => {
                        prop_assert!(looks >= LEAST_LOOKS && slowest <= 300 && now >= 30_000);
                        return Ok(());
                    }
                    Verdict::RollBack(reason) => {
                        prop_assert_eq!(slowest > 300, reason == RollbackReason::TooSlow);
                        return Ok(());
                    }
                }
            }
        }
    }
}
