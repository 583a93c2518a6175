use core::convert::Infallible;
use std::vec::Vec;

use embedded_hal::digital::{self, ErrorType};
use proptest::prelude::*;

use super::*;

/// The pattern spelled out, one entry per millisecond of one period.
fn spelled_out(pattern: Pattern) -> Vec<bool> {
    let mut lit = Vec::new();
    for (index, &ms) in pattern.table_ms().iter().enumerate() {
        lit.extend(std::iter::repeat_n(index % 2 == 0, usize::from(ms)));
    }
    lit
}

#[test]
fn tables_keep_their_rules() {
    for pattern in Pattern::ALL {
        let table = pattern.table_ms();
        assert!(
            !table.is_empty() && table.len().is_multiple_of(2),
            "{pattern:?}"
        );
        assert!(
            table.iter().all(|&ms| ms >= 60),
            "{pattern:?}: too short to see"
        );
        assert!(pattern.period() <= LONGEST_PERIOD, "{pattern:?}");
        for other in Pattern::ALL {
            assert!(
                pattern == other || spelled_out(pattern) != spelled_out(other),
                "{pattern:?} looks like {other:?}"
            );
        }
    }
}

/// Flashes of one period, in order: long or short.
fn flashes(pattern: Pattern) -> Vec<bool> {
    let lit = pattern.table_ms().iter().step_by(2);
    lit.map(|&ms| ms >= 400).collect()
}

#[test]
fn what_needs_a_person_is_told_apart_by_counting() {
    let counted = [
        Pattern::LowBattery,
        Pattern::NoLink,
        Pattern::Error,
        Pattern::RangerFault,
        Pattern::MotorFault,
        Pattern::NoNetwork,
        Pattern::NetworkPassword,
        Pattern::NoAddress,
        Pattern::BrokerRefuses,
    ];
    for pattern in counted {
        let table = pattern.table_ms();
        let pause = table.last().copied().unwrap();
        let inside = table.iter().skip(1).step_by(2).rev().skip(1).max().unwrap();
        assert!(pause > *inside, "{pattern:?}: no telling where it begins");
        for other in counted {
            assert!(
                pattern == other || flashes(pattern) != flashes(other),
                "{pattern:?} counts like {other:?}"
            );
        }
    }
}

#[test]
fn all_lists_every_pattern() {
    // A new pattern does not compile until it is counted here, and then fails until it is listed.
    let index = |pattern| match pattern {
        Pattern::Initializing => 0,
        Pattern::Idle => 1,
        Pattern::Moving => 2,
        Pattern::Scanning => 3,
        Pattern::Caution => 4,
        Pattern::Avoiding => 5,
        Pattern::Updating => 6,
        Pattern::Error => 7,
        Pattern::Identify => 8,
        Pattern::LowBattery => 9,
        Pattern::NoLink => 10,
        Pattern::RangerFault => 11,
        Pattern::MotorFault => 12,
        Pattern::NoNetwork => 13,
        Pattern::NetworkPassword => 14,
        Pattern::NoAddress => 15,
        Pattern::BrokerRefuses => 16,
        Pattern::BrokerUntrusted => 17,
    };
    let listed: Vec<usize> = Pattern::ALL.into_iter().map(index).collect();
    assert_eq!(
        listed,
        (0..=index(Pattern::BrokerUntrusted)).collect::<Vec<_>>()
    );
}

#[test]
fn every_millisecond_of_two_periods() {
    for pattern in Pattern::ALL {
        let want = spelled_out(pattern);
        let period = want.len();
        assert_eq!(pattern.period().as_millis() as usize, period);
        for at in 0..2 * period {
            for us in [0, 1, 999] {
                let elapsed = Duration::from_micros(at as u64 * 1_000 + us);
                let (lit, next) = level(pattern, elapsed);
                assert_eq!(lit, want[at % period], "{pattern:?} at {at} ms");
                let change = (at + 1..at + 1 + period).find(|later| want[later % period] != lit);
                assert_eq!(next, Duration::from_millis(change.unwrap() as u64));
            }
        }
    }
}

#[test]
fn the_end_of_time_is_no_trap() {
    for pattern in Pattern::ALL {
        let (_, next) = level(pattern, Duration::from_micros(u64::MAX));
        assert_eq!(next, Duration::from_micros(u64::MAX));
    }
}

#[derive(Debug, Default)]
struct Pin {
    lit: Option<bool>,
    broken: bool,
}

#[derive(Debug)]
struct Refused;

impl digital::Error for Refused {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Pin {
    type Error = Refused;
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Refused> {
        self.lit = Some(false);
        if self.broken { Err(Refused) } else { Ok(()) }
    }
    fn set_high(&mut self) -> Result<(), Refused> {
        self.lit = Some(true);
        if self.broken { Err(Refused) } else { Ok(()) }
    }
}

#[test]
fn the_constructor_touches_nothing() {
    assert_eq!(Lamp::new(Pin::default()).pin.lit, None);
}

#[test]
fn a_new_pattern_starts_from_its_beginning() {
    let mut lamp = Lamp::new(Pin::default());
    let start = Instant::from_millis(10_123);
    let next = lamp.show(Pattern::Idle, start).unwrap();
    assert_eq!(
        (lamp.pin.lit, next),
        (Some(true), Instant::from_millis(10_183))
    );
    let next = lamp.show(Pattern::Idle, next).unwrap();
    assert_eq!(
        (lamp.pin.lit, next),
        (Some(false), Instant::from_millis(12_123))
    );
    // In the dark part of one pattern comes another.
    let now = Instant::from_millis(11_000);
    let next = lamp.show(Pattern::Error, now).unwrap();
    assert_eq!(
        (lamp.pin.lit, next),
        (Some(true), Instant::from_millis(11_100))
    );
}

#[test]
fn a_pin_that_refuses_is_told_and_tried_again() {
    let mut lamp = Lamp::new(Pin::default());
    lamp.pin.broken = true;
    let refused = Err(LampError(ErrorKind::Other));
    assert_eq!(lamp.show(Pattern::Caution, Instant::BOOT), refused);
    lamp.pin.broken = false;
    let next = lamp
        .show(Pattern::Caution, Instant::from_millis(350))
        .unwrap();
    assert_eq!(
        (lamp.pin.lit, next),
        (Some(false), Instant::from_millis(600))
    );
}

#[test]
fn a_pin_that_cannot_fail_fits() {
    struct Level;
    impl ErrorType for Level {
        type Error = Infallible;
    }
    impl OutputPin for Level {
        fn set_low(&mut self) -> Result<(), Infallible> {
            panic!("starts dark")
        }
        fn set_high(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }
    let next = Lamp::new(Level).show(Pattern::Moving, Instant::BOOT);
    assert_eq!(next, Ok(Instant::from_millis(800)));
}

proptest! {
    /// Waking only when told shows the same as looking all the time.
    #[test]
    fn next_change_is_later_and_nothing_happens_before_it(
        pattern in prop::sample::select(&Pattern::ALL[..]),
        elapsed_us in 0..u64::MAX / 2,
        part in 0.0..1.0_f64,
    ) {
        let (lit, next) = level(pattern, Duration::from_micros(elapsed_us));
        let wait_us = next.as_micros() - elapsed_us;
        prop_assert!(wait_us > 0);
        let between = elapsed_us + (wait_us as f64 * part) as u64;
        prop_assert_eq!(level(pattern, Duration::from_micros(between)), (lit, next));
        prop_assert_eq!(level(pattern, next).0, !lit);
    }
}
