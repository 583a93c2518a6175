//! Tests of the limits.

use proptest::prelude::*;

use super::*;

const SECOND: Duration = Duration::from_secs(1);

fn attempts(most: usize) -> Attempts<u32> {
    Attempts::new(Backoff {
        free: 3,
        first: SECOND,
        longest: 8 * SECOND,
        forget: 60 * SECOND,
        most,
    })
}

#[test]
fn a_few_failures_are_free_then_the_wait_doubles_up_to_the_longest() {
    let mut attempts = attempts(10);
    let mut now = Instant::now();
    for _ in 0..3 {
        assert_eq!(attempts.begin(&1, now), Ok(()));
    }
    for expected in [1, 2, 4, 8, 8, 8] {
        let wait = expected * SECOND;
        assert_eq!(attempts.begin(&1, now), Err(wait));
        let almost = now + wait.saturating_sub(Duration::from_millis(1));
        assert_eq!(attempts.begin(&1, almost), Err(Duration::from_millis(1)));
        now += wait;
        assert_eq!(attempts.begin(&1, now), Ok(()));
    }
    assert_eq!(
        attempts.check(&2, now),
        Ok(()),
        "another key is another key"
    );
}

#[test]
fn success_and_time_make_good_again() {
    let mut attempts = attempts(10);
    let now = Instant::now();
    for _ in 0..5 {
        attempts.failed(&1, now);
        attempts.failed(&2, now);
    }
    assert!(attempts.check(&1, now).is_err());
    attempts.succeeded(&1);
    assert_eq!(attempts.check(&1, now), Ok(()));
    assert_eq!(attempts.len(), 1);
    let later = now + 60 * SECOND;
    attempts.failed(&2, later);
    assert_eq!(attempts.check(&2, later), Ok(()), "the first failure again");
}

#[test]
fn many_at_the_same_time_count_as_many() {
    let mut attempts = attempts(10);
    let now = Instant::now();
    let passed = (0..100).filter(|_| attempts.begin(&1, now).is_ok()).count();
    assert_eq!(passed, 3);
}

#[test]
fn the_memory_is_bounded_and_keeps_the_worst() {
    let mut attempts = attempts(100);
    let now = Instant::now();
    for _ in 0..6 {
        attempts.failed(&0, now);
    }
    for key in 1..10_000 {
        attempts.failed(&key, now + Duration::from_micros(key.into()));
        assert!(attempts.len() <= 100);
    }
    assert!(
        attempts.check(&0, now).is_err(),
        "forgotten under a flood of others"
    );
    attempts.failed(&10_000, now + 3_600 * SECOND);
    assert!(attempts.len() <= 100);
    assert!(!attempts.is_empty());
}

#[test]
fn a_clock_that_goes_back_frees_nobody() {
    let mut attempts = attempts(10);
    let now = Instant::now();
    for _ in 0..6 {
        attempts.failed(&1, now + 5 * SECOND);
    }
    assert_eq!(attempts.check(&1, now), Err(8 * SECOND));
}

#[test]
fn the_usual_settings_leave_a_hundred_guesses_a_day() {
    let mut attempts = Attempts::new(Backoff::default());
    let (start, mut guesses) = (Instant::now(), 0);
    let mut now = start;
    while now - start < 24 * 3_600 * SECOND {
        match attempts.begin(&"ada", now) {
            Ok(()) => guesses += 1,
            Err(wait) => now += wait,
        }
    }
    assert!((50..120).contains(&guesses), "{guesses}");
}

const ALLOWANCE: Allowance = Allowance {
    per_second: 10.0,
    burst: 20.0,
    debt: 50.0,
    patience: Duration::from_secs(5),
};

#[test]
fn who_stays_within_the_allowance_never_waits() {
    let start = Instant::now();
    let mut flood = Flood::new(ALLOWANCE, start);
    for message in 0..1_000_u32 {
        let now = start + message * Duration::from_millis(125);
        assert_eq!(flood.spend(1.0, now), Verdict::Pass);
    }
}

#[test]
fn a_burst_passes_and_then_waits_as_long_as_it_owes() {
    let now = Instant::now();
    let mut flood = Flood::new(ALLOWANCE, now);
    assert_eq!(flood.spend(20.0, now), Verdict::Pass);
    assert_eq!(flood.spend(5.0, now), Verdict::Wait(SECOND / 2));
    assert_eq!(flood.spend(5.0, now), Verdict::Wait(SECOND));
    assert_eq!(flood.spend(5.0, now + 3 * SECOND), Verdict::Pass);
}

#[test]
fn who_owes_too_much_is_cut_off() {
    let now = Instant::now();
    let mut flood = Flood::new(ALLOWANCE, now);
    assert_eq!(flood.spend(71.0, now), Verdict::CutOff);
    let mut flood = Flood::new(ALLOWANCE, now);
    assert_eq!(flood.spend(1e300, now), Verdict::CutOff);
    // What is owed is bounded: a pause of known length makes good again.
    assert_eq!(flood.spend(1.0, now + 6 * SECOND), Verdict::Pass);
}

#[test]
fn who_waits_as_told_but_never_pauses_is_cut_off_after_a_while() {
    let start = Instant::now();
    let mut now = start;
    let mut flood = Flood::new(ALLOWANCE, now);
    let cut = loop {
        match flood.spend(1.0, now) {
            Verdict::Pass => {}
            Verdict::Wait(wait) => now += wait,
            Verdict::CutOff => break now - start,
        }
        assert!(now - start < 60 * SECOND, "never cut off");
    };
    assert!(cut >= 5 * SECOND && cut < 6 * SECOND, "{cut:?}");
}

#[test]
fn who_pauses_is_not_cut_off() {
    let mut now = Instant::now();
    let mut flood = Flood::new(ALLOWANCE, now);
    for _ in 0..100 {
        for _ in 0..25 {
            match flood.spend(1.0, now) {
                Verdict::Pass => {}
                Verdict::Wait(wait) => now += wait,
                Verdict::CutOff => panic!("cut off in spite of pauses"),
            }
        }
        now += 2 * SECOND;
    }
}

proptest! {
    /// Whatever is sent when: in the long run no more passes than the allowance has.
    #[test]
    fn no_more_passes_than_is_allowed(
        sent in prop::collection::vec((0.0_f64..40.0, 0_u32..3_000), 1..200),
    ) {
        let start = Instant::now();
        let mut flood = Flood::new(ALLOWANCE, start);
        let (mut now, mut passed) = (start, 0.0);
        for (units, pause) in sent {
            now += Duration::from_millis(pause.into());
            if flood.spend(units, now) == Verdict::Pass {
                passed += units;
            }
            let seconds = (now - start).as_secs_f64();
            prop_assert!(passed <= ALLOWANCE.burst + seconds * ALLOWANCE.per_second + 1e-6);
        }
    }

    #[test]
    fn hostile_numbers_do_not_panic(units in any::<f64>(), rate in any::<f64>(), debt in any::<f64>()) {
        let now = Instant::now();
        let allowance = Allowance { per_second: rate, debt, ..ALLOWANCE };
        let mut flood = Flood::new(allowance, now);
        for _ in 0..3 {
            let _ = flood.spend(units, now + SECOND);
        }
    }

    #[test]
    fn the_list_never_grows_beyond_its_bound(
        failures in prop::collection::vec((0_u32..50, 0_u64..100), 0..400), most in 0_usize..20,
    ) {
        let mut attempts = attempts(most);
        let mut now = Instant::now();
        for (key, pause) in failures {
            now += Duration::from_secs(pause);
            attempts.failed(&key, now);
            prop_assert!(attempts.len() <= most.max(1));
        }
    }
}
