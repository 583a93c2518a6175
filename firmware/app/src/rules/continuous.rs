//! Continuous driving: in force while words come, and over in time when they do not.

use std::format;
use std::vec::Vec;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, ParameterValue, RobotState};
use proptest::prelude::*;

use super::bench::Bench;
use super::happening::Number;
use crate::controller::{FAILSAFE, HOLD, PERIOD};

/// What rounding may take of a duty that is computed anew in every period.
const ROUNDING: f32 = 1e-6;

fn bench(seed: u64, ramp_percent: u8) -> Bench {
    let mut bench = Bench::new(seed);
    let percent = ParameterValue::Number(f32::from(ramp_percent));
    bench.set("ramp_step", percent);
    bench
}

fn magnitudes(bench: &Bench) -> [f32; 2] {
    bench.robot.snapshot().wheels.map(f32::abs)
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 2_000, ..crawler_properties::cases(300) })]

    /// For every ramp there is, and periods of up to twice their length: words at the pace of
    /// a controller are obeyed in full, and 500 ms after the last one the wheels stand.
    #[test]
    fn the_wheels_stand_in_time_whatever_the_ramp(
        seed in any::<u64>(),
        ramp_percent in 1_u8..=20,
        v in -1.0_f32..1.0,
        w in -4.0_f32..4.0,
        pauses in prop::collection::vec(50_u64..=200, 0..20),
        periods in prop::collection::vec(1_u64..40, 100),
    ) {
        let mut bench = bench(seed, ramp_percent);
        let drive = Action::Drive { v, w };
        let mut pauses = pauses.into_iter();
        let mut next = Some(bench.now());
        let mut last_word = bench.now();
        let mut before = [0.0; 2];
        for period in periods.into_iter().cycle() {
            if next.is_some_and(|at| at <= bench.now()) {
                bench.send(&drive, 0, Number::Next, 0)?;
                last_word = bench.now();
                next = pauses.next().map(|ms| last_word + Duration::from_millis(ms));
            }
            bench.turn(Duration::from_millis(period), None)?;
            let (age, after) = (bench.now() - last_word, magnitudes(&bench));
            if age < HOLD {
                prop_assert_eq!(bench.state(), RobotState::Moving);
                prop_assert!(
                    (0..2).all(|wheel| after[wheel] >= before[wheel] - ROUNDING),
                    "slows down from {:?} to {:?}, {:?} after a word", before, after, age
                );
            }
            before = after;
            if age >= FAILSAFE {
                prop_assert_eq!(after, [0.0; 2]);
                prop_assert_eq!(bench.state(), RobotState::Idle);
                break;
            }
        }
    }
}

/// Age of the last word at each step from when the wheels first slow down to when they stand, and how
/// much duty they lose in it, in steps of [`PERIOD`].
fn slowing_down(ramp_percent: u8, v: f32) -> Vec<(u64, f32)> {
    let mut bench = bench(1, ramp_percent);
    let mut last_word = Instant::BOOT;
    for _ in 0..40 {
        bench
            .send(&Action::Drive { v, w: 0.0 }, 0, Number::Next, 0)
            .expect("sent");
        last_word = bench.now();
        for _ in 0..7 {
            bench.turn(PERIOD, None).expect("the rules hold");
        }
    }
    let mut before = magnitudes(&bench)[0];
    assert!(before > 0.0);
    let mut losses = Vec::new();
    while before > 0.0 {
        bench.turn(PERIOD, None).expect("the rules hold");
        let after = magnitudes(&bench)[0];
        if after < before {
            losses.push(((bench.now() - last_word).as_millis(), before - after));
        }
        before = after;
    }
    losses
}

#[test]
fn the_ramp_is_kept_where_it_is_fast_enough() {
    for (ramp_percent, v, begins) in [(20, 0.5, 400), (10, 0.2, 400), (5, 0.1, 380)] {
        let losses = slowing_down(ramp_percent, v);
        let (first, last) = (losses[0].0, losses[losses.len() - 1].0);
        let told = format!("{ramp_percent} % at {v} m/s: {losses:?}");
        assert_eq!((first, last), (begins, 480), "{told}");
        let step = f32::from(ramp_percent) * 0.01 + 1e-5;
        assert!(losses.iter().all(|(_, loss)| *loss <= step), "{told}");
    }
}

#[test]
fn a_ramp_that_is_too_slow_is_made_steeper_and_even() {
    for ramp_percent in [1, 2, 5] {
        let losses = slowing_down(ramp_percent, 0.5);
        let ages: Vec<u64> = losses.iter().map(|(age, _)| *age).collect();
        assert_eq!(
            ages,
            (300..=480).step_by(20).collect::<Vec<_>>(),
            "{ramp_percent} %"
        );
        for (_, loss) in &losses {
            assert!(
                (loss - losses[0].1).abs() < 1e-4 && *loss <= 0.1,
                "{losses:?}"
            );
        }
    }
}
