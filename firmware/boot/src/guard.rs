//! The decision in the first lines of `main`, before the radio and everything else that could fail.

use crawler_hal::ResetCause;

use crate::otadata::{Counter, Standing};
use crate::reason::RollbackReason;

/// Starts that a program on trial is allowed after it panicked or hung.
pub const ATTEMPTS_AFTER_CRASH: u32 = 1;
/// Starts that it is allowed after the power went, or somebody pressed reset: which need not be its doing.
pub const ATTEMPTS_AFTER_POWER: u32 = 3;
/// Starts that it is allowed after it asked for them. Free for all that is done on purpose, yet a program
/// that restarts itself for ever is given up.
pub const RESTARTS: u32 = 16;

/// What `main` does first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// The program is proven. Run it.
    Confirmed,
    /// The program is proven, and runs because the one that was to be tried does not start. Run it, write
    /// the reason into the trailer of the other slot, and reach [`crate::otadata::Goal::Keep`].
    Returned(RollbackReason),
    /// The program is on trial. Count this start ([`crate::otadata::Otadata::count`]), then run it under a
    /// [`crate::Trial`].
    Run(Counter),
    /// Write the reason into the trailer of this slot, reach [`crate::otadata::Goal::GiveUp`], and
    /// restart.
    RollBack(RollbackReason),
}

/// Decides from the cause of this start, what otadata says of the slot that runs, and the reason that its
/// trailer holds if it was already given up ([`crate::trailer::Trailer::rolled_back`]).
///
/// A program without a way back is never given up: it is all there is.
#[must_use]
pub fn decide(cause: ResetCause, standing: Standing, recorded: Option<RollbackReason>) -> Decision {
    let counts = match standing {
        Standing::Proven => return Decision::Confirmed,
        Standing::Returned => return Decision::Returned(RollbackReason::BadImage),
        Standing::OnTrial(counts) => counts,
    };
    let (counter, used, allowed, reason) = match cause {
        ResetCause::Software => (
            Counter::Restarts,
            counts.restarts,
            RESTARTS,
            RollbackReason::Restarts,
        ),
        ResetCause::Panic => (
            Counter::Attempts,
            counts.attempts,
            ATTEMPTS_AFTER_CRASH,
            RollbackReason::Panic,
        ),
        ResetCause::Watchdog => (
            Counter::Attempts,
            counts.attempts,
            ATTEMPTS_AFTER_CRASH,
            RollbackReason::Watchdog,
        ),
        // Power-on, brown-out, the reset pin, and what a later chip may name.
        _ => (
            Counter::Attempts,
            counts.attempts,
            ATTEMPTS_AFTER_POWER,
            RollbackReason::PowerCycles,
        ),
    };
    if !counts.way_back {
        Decision::Run(counter)
    } else if let Some(reason) = recorded {
        Decision::RollBack(reason)
    } else if counts.giving_up {
        Decision::RollBack(RollbackReason::Interrupted)
    } else if used >= allowed {
        Decision::RollBack(reason)
    } else {
        Decision::Run(counter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::otadata::TrialCounts;

    const CAUSES: [ResetCause; 6] = [
        ResetCause::PowerOn,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::BrownOut,
        ResetCause::Panic,
        ResetCause::External,
    ];

    const FRESH: TrialCounts = TrialCounts {
        attempts: 0,
        restarts: 0,
        way_back: true,
        giving_up: false,
    };

    /// Starts a program on trial again and again for the same cause; how often it runs, and why not again.
    fn starts(cause: ResetCause) -> (u32, RollbackReason) {
        let mut counts = FRESH;
        for ran in 0.. {
            match decide(cause, Standing::OnTrial(counts), None) {
                Decision::Run(Counter::Attempts) => counts.attempts += 1,
                Decision::Run(Counter::Restarts) => counts.restarts += 1,
                Decision::RollBack(reason) => return (ran, reason),
                other => panic!("{other:?}"),
            }
        }
        unreachable!()
    }

    #[test]
    fn each_cause_has_its_number_of_attempts() {
        assert_eq!(starts(ResetCause::Panic), (1, RollbackReason::Panic));
        assert_eq!(starts(ResetCause::Watchdog), (1, RollbackReason::Watchdog));
        assert_eq!(
            starts(ResetCause::PowerOn),
            (3, RollbackReason::PowerCycles)
        );
        assert_eq!(
            starts(ResetCause::BrownOut),
            (3, RollbackReason::PowerCycles)
        );
        assert_eq!(
            starts(ResetCause::External),
            (3, RollbackReason::PowerCycles)
        );
        assert_eq!(starts(ResetCause::Software), (16, RollbackReason::Restarts));
    }

    #[test]
    fn restarts_that_were_asked_for_cost_no_attempt() {
        let counts = TrialCounts {
            restarts: RESTARTS - 1,
            ..FRESH
        };
        for cause in CAUSES {
            let decision = decide(cause, Standing::OnTrial(counts), None);
            assert!(matches!(decision, Decision::Run(_)), "{cause:?}");
        }
    }

    #[test]
    fn what_is_proven_runs_and_what_has_no_way_back_is_not_given_up() {
        let alone = TrialCounts {
            attempts: 32,
            restarts: 32,
            way_back: false,
            giving_up: true,
        };
        for cause in CAUSES {
            for recorded in [None, Some(RollbackReason::NoLink)] {
                let proven = decide(cause, Standing::Proven, recorded);
                assert_eq!(proven, Decision::Confirmed);
                let returned = decide(cause, Standing::Returned, recorded);
                assert_eq!(returned, Decision::Returned(RollbackReason::BadImage));
                let runs = decide(cause, Standing::OnTrial(alone), recorded);
                assert!(matches!(runs, Decision::Run(_)), "{cause:?}");
            }
        }
    }

    #[test]
    fn a_trial_that_was_being_given_up_is_given_up() {
        let torn = TrialCounts {
            giving_up: true,
            ..FRESH
        };
        for cause in CAUSES {
            let recorded = Some(RollbackReason::SelfTest);
            for counts in [FRESH, torn] {
                let decision = decide(cause, Standing::OnTrial(counts), recorded);
                assert_eq!(decision, Decision::RollBack(RollbackReason::SelfTest));
            }
            let decision = decide(cause, Standing::OnTrial(torn), None);
            assert_eq!(decision, Decision::RollBack(RollbackReason::Interrupted));
        }
    }
}
