//! Random commands, rhythms and faults.

use std::vec::Vec;

use crawler_hal::{Duration, Instant};
use proptest::prelude::*;

use super::bench::Bench;
use super::{OUTPUTS, SIDES};
use crate::l298n::{Config, Duty, Fault, MotorError, Side, Trim};

#[derive(Debug, Clone)]
enum Step {
    Apply(f32, f32),
    Coast,
    Brake,
    Break(Vec<(bool, u8)>),
}

fn share() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -1.2..1.2_f32,
        2 => prop_oneof![Just(1.0_f32), Just(-1.0), Just(0.0), Just(0.002), Just(-0.002)],
        1 => any::<u32>().prop_map(f32::from_bits),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        12 => (share(), share()).prop_map(|(left, right)| Step::Apply(left, right)),
        2 => Just(Step::Coast),
        2 => Just(Step::Brake),
        1 => prop::collection::vec((any::<bool>(), 0..3_u8), 0..3).prop_map(Step::Break),
    ]
}

proptest! {
    #![proptest_config(crawler_properties::cases(2_000))]

    /// Also with outputs that fail and come back, and calls at any rhythm.
    #[test]
    fn no_wheel_reverses_within_the_dead_time(
        dead_ms in 1..=200_u64,
        max_duty in prop_oneof![Just(255_u16), Just(100), any::<u16>().prop_map(|max| max.max(1))],
        trims in (0.5..=1.0_f32, 0.5..=1.0_f32),
        steps in prop::collection::vec((0..60_000_u64, step()), 1..80),
    ) {
        let dead_time = Duration::from_millis(dead_ms);
        let config = Config::new()
            .with_dead_time(dead_time).unwrap()
            .with_trim(Trim::new(trims.0).unwrap(), Trim::new(trims.1).unwrap());
        let (bench, mut motors) = Bench::new(max_duty, config);
        let mut now = Instant::BOOT;
        for (wait_us, step) in steps {
            now = bench.at(now + Duration::from_micros(wait_us));
            let outcome = match step {
                Step::Apply(left, right) => {
                    let (left, right) = (Duty::new(left), Duty::new(right));
                    motors.apply(left, right, now).map(|applied| {
                        for (side, wheel, wanted) in [
                            (Side::Left, applied.left, left),
                            (Side::Right, applied.right, right),
                        ] {
                            let bridge = bench.side(side).borrow();
                            let real = i32::from(wheel.duty.steps()) * i32::from(max_duty) / 255;
                            assert_eq!(bridge.drive(), real, "told otherwise than done");
                            assert!([Duty::ZERO, wanted].contains(&wheel.command));
                            assert!(wheel.duty.magnitude() <= wanted.magnitude());
                        }
                    })
                }
                Step::Coast => motors.coast(now).map(|()| assert_eq!(bench.drives(), [0; 2])),
                Step::Brake => motors.brake().map(|()| {
                    assert!(SIDES.iter().all(|&side| bench.side(side).borrow().brakes()));
                }),
                Step::Break(outputs) => {
                    let faults: Vec<Fault> = outputs.into_iter().map(|(left, output)| Fault {
                        side: if left { Side::Left } else { Side::Right },
                        output: OUTPUTS[usize::from(output)],
                    }).collect();
                    bench.break_outputs(&faults);
                    Ok(())
                }
            };
            if let Err(MotorError::Stopped(_)) = outcome {
                prop_assert_eq!(bench.drives(), [0; 2]);
            }
        }
        for side in SIDES {
            let gap = bench.side(side).borrow().shortest_gap;
            prop_assert!(gap.is_none_or(|gap| gap >= dead_time), "{:?}: {:?}", side, gap);
        }
    }

    /// The dead time is a delay, not a refusal.
    #[test]
    fn every_command_is_obeyed_in_the_end(
        before in prop::collection::vec((0..60_u64, step()), 0..20),
        left in share(),
        right in share(),
    ) {
        let (bench, mut motors) = Bench::new(255, Config::new());
        let mut now = Instant::BOOT;
        for (wait_ms, step) in before {
            now = bench.at(now + Duration::from_millis(wait_ms));
            match step {
                Step::Apply(left, right) => {
                    motors.apply(Duty::new(left), Duty::new(right), now).unwrap();
                }
                Step::Coast => motors.coast(now).unwrap(),
                Step::Brake => motors.brake().unwrap(),
                Step::Break(_) => {}
            }
        }
        let (left, right) = (Duty::new(left), Duty::new(right));
        for _ in 0..3 {
            motors.apply(left, right, bench.at(now)).unwrap();
            now += Duration::from_millis(20);
        }
        prop_assert_eq!(bench.drives(), [i32::from(left.steps()), i32::from(right.steps())]);
    }
}
