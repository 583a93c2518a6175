//! The driver against a bridge that keeps the record of its wheels.

use std::convert::Infallible;
use std::format;
use std::vec::Vec;

use embedded_hal::{digital, pwm};

use super::*;

mod bench;
mod properties;

use bench::Bench;

const OUTPUTS: [Output; 3] = [Output::Enable, Output::In1, Output::In2];
const SIDES: [Side; 2] = [Side::Left, Side::Right];

fn ms(ms: u64) -> Instant {
    Instant::from_millis(ms)
}

#[test]
fn no_float_makes_a_duty_out_of_range() {
    for bits in (0..=u32::MAX).step_by(997) {
        let share = f32::from_bits(bits);
        let steps = Duty::new(share).steps();
        if share.is_finite() {
            let want = f64::from(share).clamp(-1.0, 1.0) * 255.0;
            // Half a step, and what f32 rounds away of the product.
            let error = (f64::from(steps) - want).abs();
            assert!(error <= 0.5001, "{share}: {steps} for {want}");
        } else {
            assert_eq!(steps, 0, "{share}");
        }
    }
    for (share, steps) in [
        (1.0, 255),
        (-1.0, -255),
        (7.0, 255),
        (-7.0, -255),
        (0.5, 128),
        (-0.5, -128),
        (0.6, 153),
        (0.001, 0),
        (0.002, 1),
        (-0.0, 0),
        (f32::NAN, 0),
        (f32::INFINITY, 0),
        (f32::NEG_INFINITY, 0),
        (f32::MAX, 255),
        (f32::MIN_POSITIVE, 0),
    ] {
        assert_eq!(Duty::new(share).steps(), steps, "{share}");
    }
}

#[test]
fn every_step_survives_the_way_through_a_share() {
    for steps in i16::MIN..=i16::MAX {
        let duty = Duty::from_steps(steps);
        assert_eq!(duty.steps(), steps.clamp(-255, 255));
        assert_eq!(Duty::new(duty.share()), duty);
    }
}

#[test]
fn trim_holds_back_and_never_pushes() {
    for permille in 500..=1_000_u16 {
        let trim = Trim::new(f32::from(permille) * 1e-3).unwrap();
        assert!((trim.share() - f32::from(permille) * 1e-3).abs() < 1e-6);
        for steps in -255..=255_i16 {
            let got = trim.apply(Duty::from_steps(steps)).steps();
            let want = f64::from(steps) * f64::from(permille) / 1_000.0;
            assert!((f64::from(got) - want).abs() <= 0.5, "{steps} · {permille}");
            assert_eq!(got.signum(), steps.signum(), "a command was trimmed away");
        }
    }
    for bad in [0.499, 0.0, -1.0, 1.001, f32::NAN, f32::INFINITY] {
        assert_eq!(Trim::new(bad), Err(ConfigError::Trim), "{bad}");
    }
}

#[test]
fn absurd_dead_times_are_refused() {
    for (us, good) in [
        (0, false),
        (999, false),
        (1_000, true),
        (1_000_000, true),
        (1_000_001, false),
        (u64::MAX, false),
    ] {
        let config = Config::new().with_dead_time(Duration::from_micros(us));
        assert_eq!(config.is_ok(), good, "{us}");
        assert_eq!(
            config.map(|config| config.dead_time().as_micros()),
            if good {
                Ok(us)
            } else {
                Err(ConfigError::DeadTime)
            }
        );
    }
}

#[test]
fn the_constructor_touches_nothing() {
    let (bench, motors) = Bench::new(255, Config::new());
    drop(motors.release());
    assert!(
        SIDES
            .iter()
            .all(|&side| bench.side(side).borrow().writes == 0)
    );
}

#[test]
fn a_wheel_of_unknown_state_rests_first() {
    let (bench, mut motors) = Bench::new(255, Config::new());
    let full = Duty::FULL;
    for (at, want) in [(5, 0), (25, 0), (44, 0), (45, 255), (65, 255)] {
        let now = bench.at(ms(at));
        let applied = motors.apply(full, full, now).unwrap();
        assert_eq!(bench.drives(), [want; 2], "at {at} ms");
        assert_eq!(i32::from(applied.left.duty.steps()), want);
    }
}

/// After a restart without a power cycle, the outputs may be anything.
#[test]
fn no_state_of_the_outputs_makes_the_first_call_drive() {
    for levels in 0..4 {
        for braked in [false, true] {
            let (bench, mut motors) = Bench::new(255, Config::new());
            for side in SIDES {
                bench
                    .side(side)
                    .borrow_mut()
                    .found_at(levels & 1 == 1, levels & 2 == 2);
            }
            if braked {
                motors.brake().unwrap();
            } else {
                let applied = motors.apply(Duty::FULL, Duty::new(-1.0), bench.at(ms(0)));
                assert_eq!(applied, Ok(Applied::default()));
            }
            assert_eq!(bench.drives(), [0; 2]);
            for side in SIDES {
                assert_eq!(bench.side(side).borrow().driven, [], "{levels} {braked}");
            }
        }
    }
}

#[test]
fn a_reversal_passes_zero_for_the_dead_time_and_then_happens() {
    let (bench, mut motors, start) = Bench::driving(0.8);
    let back = Duty::new(-0.8);
    for (after, want) in [(20, 0), (40, 0), (59, 0), (60, -204), (80, -204)] {
        let now = bench.at(start + Duration::from_millis(after));
        let applied = motors.apply(back, back, now).unwrap();
        assert_eq!(bench.drives(), [want; 2], "after {after} ms");
        let command = if want == 0 { Duty::ZERO } else { back };
        assert_eq!(
            (applied.left.command, applied.right.command),
            (command, command)
        );
    }
}

#[test]
fn going_on_the_same_way_needs_no_dead_time() {
    let (bench, mut motors, start) = Bench::driving(0.8);
    let now = bench.at(start + Duration::from_millis(20));
    motors.coast(now).unwrap();
    assert_eq!(bench.drives(), [0; 2]);
    let now = bench.at(now + Duration::from_millis(1));
    motors.apply(Duty::FULL, Duty::FULL, now).unwrap();
    assert_eq!(bench.drives(), [255; 2]);
}

#[test]
fn standing_counts_as_dead_time() {
    let (bench, mut motors, start) = Bench::driving(0.8);
    for after in [20, 40, 60, 80] {
        motors
            .coast(bench.at(start + Duration::from_millis(after)))
            .unwrap();
    }
    let now = bench.at(start + Duration::from_millis(81));
    motors.apply(Duty::new(-1.0), Duty::FULL, now).unwrap();
    assert_eq!(bench.drives(), [-255, 255]);
}

#[test]
fn a_changed_dead_time_counts_at_once() {
    let (bench, mut motors, start) = Bench::driving(1.0);
    let back = Duty::new(-1.0);
    motors.apply(back, back, bench.at(start)).unwrap();
    let long = Config::new().with_dead_time(Duration::from_millis(500));
    motors.set_config(long.unwrap());
    assert_eq!(motors.config().dead_time(), Duration::from_millis(500));
    for (after, want) in [(40, 0), (499, 0), (500, -255)] {
        let now = bench.at(start + Duration::from_millis(after));
        motors.apply(back, back, now).unwrap();
        assert_eq!(bench.drives(), [want; 2], "after {after} ms");
    }
}

#[test]
fn the_wheels_are_independent() {
    let (bench, mut motors, start) = Bench::driving(0.8);
    let now = bench.at(start + Duration::from_millis(20));
    let applied = motors.apply(Duty::new(-0.8), Duty::new(0.4), now).unwrap();
    assert_eq!(bench.drives(), [0, 102]);
    assert_eq!(applied.left, Wheel::default());
    assert_eq!(applied.right.command, Duty::new(0.4));
}

#[test]
fn each_wheel_has_its_own_trim() {
    let config = Config::new().with_trim(Trim::new(0.8).unwrap(), Trim::new(0.6).unwrap());
    let (bench, mut motors) = Bench::new(255, config);
    motors.coast(bench.at(ms(0))).unwrap();
    let applied = motors
        .apply(Duty::FULL, Duty::FULL, bench.at(ms(40)))
        .unwrap();
    assert_eq!(bench.drives(), [204, 153]);
    assert_eq!(applied.left.command, Duty::FULL);
    assert_eq!(applied.left.duty, Duty::from_steps(204));
    assert_eq!(applied.right.duty, Duty::from_steps(153));
}

#[test]
fn brake_shorts_the_motors_and_is_left_through_zero() {
    let (bench, mut motors, start) = Bench::driving(0.8);
    motors.brake().unwrap();
    motors.brake().unwrap();
    for side in SIDES {
        let bridge = bench.side(side).borrow();
        assert!(bridge.brakes(), "{side:?}");
        assert_eq!(bridge.driven.len(), 1, "driven on the way into the brake");
    }
    let ahead = Duty::new(0.8);
    for (after, want) in [(20, 0), (59, 0), (60, 204)] {
        let now = bench.at(start + Duration::from_millis(after));
        motors.apply(ahead, ahead, now).unwrap();
        assert_eq!(bench.drives(), [want; 2], "after {after} ms");
        assert!(!bench.side(Side::Left).borrow().brakes());
    }
}

#[test]
fn full_duty_is_the_whole_period_of_any_timer() {
    for max_duty in [1, 100, 255, 256, 1_024, 16_000, u16::MAX] {
        let (bench, mut motors) = Bench::new(max_duty, Config::new());
        motors.coast(bench.at(ms(0))).unwrap();
        motors
            .apply(Duty::FULL, Duty::new(-1.0), bench.at(ms(40)))
            .unwrap();
        assert_eq!(bench.drives(), [i32::from(max_duty), -i32::from(max_duty)]);
        motors
            .apply(Duty::new(0.5), Duty::new(-0.5), bench.at(ms(60)))
            .unwrap();
        let half = i32::from(max_duty) * 128 / 255;
        assert_eq!(bench.drives(), [half, -half]);
    }
}

/// Every set of the six outputs refuses, from every state a robot can be in, for every call: a
/// `Stopped` is a promise, and a `Runaway` is not cried without reason.
#[test]
fn whatever_refuses_the_error_tells_the_truth() {
    let faults: Vec<Fault> = SIDES
        .iter()
        .flat_map(|&side| OUTPUTS.map(|output| Fault { side, output }))
        .collect();
    for set in 0..64_usize {
        let broken: Vec<Fault> = (0..6)
            .filter(|bit| set >> bit & 1 == 1)
            .map(|bit| faults[bit])
            .collect();
        for before in [0.7, -0.7, 0.0] {
            for braked in [false, true] {
                for call in 0..4 {
                    let (bench, mut motors, start) = Bench::driving(before);
                    if braked {
                        motors.brake().unwrap();
                    }
                    // Beyond the dead time of a wheel at rest.
                    let now = bench.at(start + Duration::from_millis(100));
                    bench.break_outputs(&broken);
                    let outcome = match call {
                        0 => motors.apply(Duty::FULL, Duty::FULL, now).map(drop),
                        1 => motors.apply(Duty::new(-1.0), Duty::FULL, now).map(drop),
                        2 => motors.coast(now),
                        _ => motors.brake(),
                    };
                    let case = format!("{broken:?}, {before}, {braked}, {call}: {outcome:?}");
                    match outcome {
                        Ok(()) if call >= 2 => assert_eq!(bench.drives(), [0; 2], "{case}"),
                        Ok(()) => {}
                        Err(MotorError::Stopped(fault)) => {
                            assert!(broken.contains(&fault), "{case}");
                            assert_eq!(bench.drives(), [0; 2], "{case}");
                        }
                        Err(MotorError::Runaway(fault)) => {
                            assert!(broken.contains(&fault), "{case}");
                            let lost = SIDES.iter().any(|&side| {
                                let out = |output| broken.contains(&Fault { side, output });
                                out(Output::Enable) && (out(Output::In1) || out(Output::In2))
                            });
                            assert!(lost, "{case}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn after_a_passing_fault_the_wheels_rest_and_then_obey() {
    let (bench, mut motors, start) = Bench::driving(0.7);
    let fault = Fault {
        side: Side::Right,
        output: Output::Enable,
    };
    bench.break_outputs(&[fault]);
    let ahead = Duty::new(0.7);
    let now = bench.at(start + Duration::from_millis(20));
    assert_eq!(
        motors.apply(ahead, ahead, now),
        Err(MotorError::Stopped(fault))
    );
    bench.break_outputs(&[]);
    for (after, want) in [(40, 0), (60, 0), (80, 179)] {
        let now = bench.at(start + Duration::from_millis(after));
        motors.apply(ahead, ahead, now).unwrap();
        assert_eq!(bench.drives(), [want; 2], "after {after} ms");
    }
}

/// A pin that cannot fail fits as well.
#[test]
fn infallible_pins_fit() {
    struct Level(bool);
    impl digital::ErrorType for Level {
        type Error = Infallible;
    }
    impl OutputPin for Level {
        fn set_low(&mut self) -> Result<(), Infallible> {
            self.0 = false;
            Ok(())
        }
        fn set_high(&mut self) -> Result<(), Infallible> {
            self.0 = true;
            Ok(())
        }
    }
    struct Timer(u16);
    impl pwm::ErrorType for Timer {
        type Error = Infallible;
    }
    impl SetDutyCycle for Timer {
        fn max_duty_cycle(&self) -> u16 {
            255
        }
        fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
            self.0 = duty;
            Ok(())
        }
    }
    let port = || MotorPort {
        enable: Timer(7),
        in1: Level(true),
        in2: Level(true),
    };
    let mut motors = L298n::new(port(), port(), Config::default());
    motors.coast(ms(0)).unwrap();
    motors
        .apply(Duty::new(-0.2), Duty::new(0.2), ms(40))
        .unwrap();
    let (left, right) = motors.release();
    assert_eq!((left.enable.0, left.in1.0, left.in2.0), (51, false, true));
    assert_eq!(
        (right.enable.0, right.in1.0, right.in2.0),
        (51, true, false)
    );
}
