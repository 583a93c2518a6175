//! Whether a new program has proven itself, from what it observes of itself.

use crawler_hal::{Duration, Instant};

use crate::reason::RollbackReason;

/// How long everything must be well without a break before a program is confirmed.
pub const PROVING: Duration = Duration::from_secs(30);
/// How long a start may take to get there: time to find the network again, and for a broker to come back.
pub const TRIAL_LIMIT: Duration = Duration::from_secs(300);
/// Observations further apart than this do not add up: nobody looked in between.
pub const MAX_GAP: Duration = Duration::from_secs(1);

/// A set of sensors: those that work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sensors(u8);

impl Sensors {
    /// None.
    pub const NONE: Self = Self(0);
    /// The ultrasonic ranger.
    pub const RANGER: Self = Self(1);
    /// The battery gauge.
    pub const BATTERY: Self = Self(1 << 1);
    /// The camera.
    pub const CAMERA: Self = Self(1 << 2);

    /// Those of both sets.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all of `other` are in it.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// As one byte, for the trailer.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// From one byte. Bits of sensors that this program does not know are kept.
    #[must_use]
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits)
    }
}

/// What a program on trial sees of itself, at least once per [`MAX_GAP`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Observation {
    /// Control periods that were missed since the start.
    pub missed: u32,
    /// Sensors that work.
    pub sensors: Sensors,
    /// Something from the server has arrived since the start: it is heard.
    pub received: bool,
    /// The broker has confirmed something since the start: it is reached.
    pub delivered: bool,
    /// A test that the program does of itself has failed.
    pub failed: bool,
}

/// What to do about a program on trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Go on.
    Pending,
    /// It has proven itself: reach [`crate::otadata::Goal::Confirm`].
    Confirm,
    /// Write the reason into the trailer, reach [`crate::otadata::Goal::GiveUp`], and restart.
    RollBack(RollbackReason),
}

/// The trial of a program since this start. Pure: time is handed in.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Sensors that worked before the update.
    before: Sensors,
    began: Instant,
    /// Since when everything has been well.
    well_since: Instant,
    observed: Instant,
    missed: u32,
    /// What broke the last stretch of being well.
    broken_by: RollbackReason,
    verdict: Verdict,
}

impl Trial {
    /// A trial that begins at `now`, with the sensors that worked before the update.
    #[must_use]
    pub const fn new(now: Instant, before: Sensors) -> Self {
        Self {
            before,
            began: now,
            well_since: now,
            observed: now,
            missed: 0,
            broken_by: RollbackReason::Timeout,
            verdict: Verdict::Pending,
        }
    }

    /// Takes an observation at `now`. A verdict other than [`Verdict::Pending`] is final.
    pub fn observe(&mut self, now: Instant, seen: &Observation) -> Verdict {
        if self.verdict != Verdict::Pending {
            return self.verdict;
        }
        let broken_by = if now - self.observed > MAX_GAP {
            Some(RollbackReason::Timeout)
        } else if seen.missed != self.missed {
            Some(RollbackReason::ControlMissed)
        } else if !seen.sensors.contains(self.before) {
            Some(RollbackReason::UnhealthySensors)
        } else {
            None
        };
        if let Some(reason) = broken_by {
            self.well_since = now;
            self.broken_by = reason;
        }
        self.missed = seen.missed;
        self.observed = now;
        let linked = seen.received && seen.delivered;
        self.verdict = if seen.failed {
            Verdict::RollBack(RollbackReason::SelfTest)
        } else if linked && now - self.well_since >= PROVING {
            Verdict::Confirm
        } else if now - self.began < TRIAL_LIMIT {
            Verdict::Pending
        } else if linked {
            Verdict::RollBack(self.broken_by)
        } else {
            Verdict::RollBack(RollbackReason::NoLink)
        };
        self.verdict
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WELL: Observation = Observation {
        missed: 0,
        sensors: Sensors::RANGER.with(Sensors::BATTERY),
        received: true,
        delivered: true,
        failed: false,
    };
    const BEFORE: Sensors = Sensors::RANGER;

    /// Observes every 500 ms until there is a verdict; when that is, in milliseconds.
    fn run(mut seen: impl FnMut(u64) -> Observation) -> (u64, Verdict) {
        let mut trial = Trial::new(Instant::BOOT, BEFORE);
        for ms in (500..).step_by(500) {
            let verdict = trial.observe(Instant::from_millis(ms), &seen(ms));
            if verdict != Verdict::Pending {
                assert_eq!(trial.observe(Instant::FAR_FUTURE, &seen(ms)), verdict);
                return (ms, verdict);
            }
        }
        unreachable!()
    }

    #[test]
    fn confirms_after_thirty_seconds_of_all_being_well() {
        assert_eq!(run(|_| WELL), (30_000, Verdict::Confirm));
    }

    #[test]
    fn a_breach_begins_the_thirty_seconds_anew() {
        let missed = |ms| Observation {
            missed: u32::from(ms >= 20_000),
            ..WELL
        };
        assert_eq!(run(missed), (50_000, Verdict::Confirm));
        let deaf = |ms| Observation {
            sensors: if ms == 29_500 {
                Sensors::BATTERY
            } else {
                WELL.sensors
            },
            ..WELL
        };
        assert_eq!(run(deaf), (59_500, Verdict::Confirm));
    }

    #[test]
    fn waits_for_both_directions_of_the_link() {
        let late = |ms| Observation {
            received: ms >= 60_000,
            delivered: ms >= 70_000,
            ..WELL
        };
        assert_eq!(run(late), (70_000, Verdict::Confirm));
        for (received, delivered) in [(true, false), (false, true), (false, false)] {
            let half = |_| Observation {
                received,
                delivered,
                ..WELL
            };
            let expected = Verdict::RollBack(RollbackReason::NoLink);
            assert_eq!(run(half), (300_000, expected));
        }
    }

    #[test]
    fn gives_up_with_what_was_wrong() {
        let worse = |_| Observation {
            sensors: Sensors::BATTERY,
            ..WELL
        };
        let expected = Verdict::RollBack(RollbackReason::UnhealthySensors);
        assert_eq!(run(worse), (300_000, expected));
        let missing = |ms| Observation {
            missed: ms as u32 / 10_000,
            ..WELL
        };
        let expected = Verdict::RollBack(RollbackReason::ControlMissed);
        assert_eq!(run(missing), (300_000, expected));
        let failed = |ms| Observation {
            failed: ms >= 2_000,
            ..WELL
        };
        let expected = Verdict::RollBack(RollbackReason::SelfTest);
        assert_eq!(run(failed), (2_000, expected));
    }

    #[test]
    fn time_in_which_nobody_looked_proves_nothing() {
        let mut trial = Trial::new(Instant::BOOT, BEFORE);
        let expected = Verdict::RollBack(RollbackReason::Timeout);
        for turn in 1..=100 {
            let verdict = trial.observe(Instant::from_millis(turn * 5_000), &WELL);
            let pending = turn < 60;
            assert_eq!(verdict, if pending { Verdict::Pending } else { expected });
        }
    }

    proptest! {
        #[test]
        fn confirms_only_what_was_well_for_thirty_seconds(
            steps in proptest::collection::vec((1_u64..1_500, 0_u8..40, any::<bool>(), any::<bool>()), 1..200),
        ) {
            let mut trial = Trial::new(Instant::BOOT, BEFORE);
            let (mut now, mut missed, mut well_for) = (0, 0, 0);
            for (gap, luck, received, delivered) in steps {
                now += gap;
                missed += u32::from(luck == 0);
                let sensors = if luck == 1 { Sensors::NONE } else { WELL.sensors };
                well_for = if luck > 1 && gap <= 1_000 { well_for + gap } else { 0 };
                let seen = Observation { missed, sensors, received, delivered, failed: false };
                match trial.observe(Instant::from_millis(now), &seen) {
                    Verdict::Pending => {
                        prop_assert!(now < 300_000);
                        prop_assert!(well_for < 30_000 || !received || !delivered);
                    }
                    Verdict::Confirm => {
                        prop_assert!(well_for >= 30_000 && received && delivered);
                        return Ok(());
                    }
                    Verdict::RollBack(_) => {
                        prop_assert!(now >= 300_000);
                        return Ok(());
                    }
                }
            }
        }
    }
}
