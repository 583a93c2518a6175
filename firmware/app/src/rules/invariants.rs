//! The rules, against random events.

use std::vec::Vec;

use crawler_hal::{Duration, Millimeters};
use crawler_protocol::{
    Action, BehaviourName, BehaviourSpec, Direction, PolicyName, Pose, RobotState,
};
use proptest::prelude::*;

use super::bench::Bench;
use super::happening::{Happening, Number, Sensor, happening};
use crate::perception::{LinkHealth, Sight};

const CASES: u32 = 300;

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 2_000, ..crawler_properties::cases(CASES) })]

    /// All rules at once: whatever happens in whatever order.
    #[test]
    fn whatever_happens_the_rules_hold(
        seed in any::<u64>(),
        happenings in prop::collection::vec(happening(), 1..120),
    ) {
        let mut bench = Bench::new(seed);
        for happening in &happenings {
            bench.happen(happening)?;
        }
    }

    /// The same for a robot that is on its way, so that motion is not the exception.
    #[test]
    fn whatever_happens_on_the_way_the_rules_hold(
        seed in any::<u64>(),
        speed in 20_u8..=100,
        happenings in prop::collection::vec(happening(), 1..40),
    ) {
        let mut bench = Bench::new(seed);
        let wander = Action::Behave(BehaviourSpec::Wander { speed });
        bench.send(&wander, 0, Number::Next, 0)?;
        bench.happen(&Happening::Run(30))?;
        prop_assert!(bench.robot.snapshot().wheels[0] > 0.0, "on its way");
        for happening in &happenings {
            bench.happen(happening)?;
        }
    }

    /// The same for a robot that drives by a policy, that of its program or one that a release has brought, whatever its
    /// network decides.
    #[test]
    fn whatever_a_network_decides_the_rules_hold(
        seed in any::<u64>(),
        brought in any::<bool>(),
        happenings in prop::collection::vec(happening(), 1..60),
    ) {
        let mut bench = Bench::new(seed);
        if brought {
            bench.bring_policy();
        }
        let policy = PolicyName::new("trained").expect("legal");
        bench.send(&Action::Behave(BehaviourSpec::Policy { policy }), 0, Number::Next, 0)?;
        bench.happen(&Happening::Run(30))?;
        prop_assert_eq!(bench.robot.snapshot().behaviour, BehaviourName::Policy);
        for happening in &happenings {
            bench.happen(happening)?;
        }
    }

    /// Rule 1, with nothing else in the way: a halt at any moment of any motion.
    #[test]
    fn a_halt_stops_the_wheels_in_its_period(
        seed in any::<u64>(),
        v in -1.0_f32..1.0,
        w in -4.0_f32..4.0,
        periods in 1_u8..24,
        emergency in any::<bool>(),
    ) {
        let mut bench = Bench::new(seed);
        bench.send(&Action::Drive { v, w }, 0, Number::Next, 0)?;
        bench.happen(&Happening::Run(periods))?;
        let halt = if emergency { Action::Estop } else { Action::Stop };
        // From the distant past and out of order, and obeyed all the same.
        bench.send(&halt, 1, Number::Older, 1_000_000)?;
        let out = bench.turn(Duration::from_millis(20), None)?;
        prop_assert_eq!(out.duties, [0.0, 0.0]);
        bench.happen(&Happening::Run(200))?;
        prop_assert_eq!(bench.robot.snapshot().wheels, [0.0, 0.0]);
    }

    /// Rule 3: a stale or repeated command moves nothing, even when the robot is ready to move.
    #[test]
    fn commands_of_another_time_move_nothing(
        seed in any::<u64>(),
        age in prop_oneof![2_100_i64..1_000_000, -1_000_000_i64..-2_100],
        number in prop_oneof![Just(Number::Repeated), Just(Number::Older)],
    ) {
        let drive = Action::Drive { v: 0.3, w: 0.0 };
        let mut bench = Bench::new(seed);
        bench.send(&drive, 0, Number::Next, age)?;
        bench.happen(&Happening::Run(10))?;
        prop_assert_eq!(bench.robot.snapshot().wheels, [0.0, 0.0]);
        // In time, and once more later.
        bench.send(&drive, 0, Number::Next, 0)?;
        bench.happen(&Happening::Run(50))?;
        prop_assert_eq!(bench.state(), RobotState::Idle);
        bench.send(&drive, 0, number, 0)?;
        bench.happen(&Happening::Run(10))?;
        prop_assert_eq!(bench.robot.snapshot().wheels, [0.0, 0.0]);
    }

    /// Rule 3: words every 150 ms keep it driving; half a second after the last one the failsafe has
    /// ended it, and it stands.
    #[test]
    fn driving_lasts_as_long_as_its_words(seed in any::<u64>(), words in 1_u32..20) {
        let mut bench = Bench::new(seed);
        for _ in 0..words {
            bench.send(&Action::Drive { v: 0.3, w: 0.0 }, 0, Number::Next, 0)?;
            for _ in 0..8 {
                bench.happen(&Happening::Run(1))?;
                prop_assert_eq!(bench.state(), RobotState::Moving);
            }
        }
        // 160 ms have passed since the last word.
        bench.happen(&Happening::Run(16))?;
        prop_assert_eq!(bench.state(), RobotState::Moving);
        bench.happen(&Happening::Run(1))?;
        prop_assert_eq!(bench.state(), RobotState::Idle);
        prop_assert_eq!(bench.robot.snapshot().wheels, [0.0, 0.0]);
    }

    /// Rule 3: a bounded move ends at its duration, not before it and not after it.
    #[test]
    fn a_bounded_move_ends_at_its_duration(seed in any::<u64>(), duration_ms in 20_u32..=10_000) {
        let mut bench = Bench::new(seed);
        let action = Action::Move { direction: Direction::Forward, speed: 100, duration_ms };
        bench.send(&action, 0, Number::Next, 0)?;
        let end = bench.now() + Duration::from_millis(u64::from(duration_ms));
        while bench.now() + Duration::from_millis(20) < end {
            bench.happen(&Happening::Run(1))?;
            prop_assert_eq!(bench.state(), RobotState::Moving);
        }
        bench.happen(&Happening::Run(1))?;
        prop_assert_eq!(bench.state(), RobotState::Idle);
        bench.happen(&Happening::Run(20))?;
        prop_assert_eq!(bench.robot.snapshot().wheels, [0.0, 0.0]);
    }

    /// Rule 4: from any motion, a silent ranger stops the wheels after 300 ms.
    #[test]
    fn a_silent_ranger_stops_the_wheels(seed in any::<u64>(), wander in any::<bool>()) {
        let mut bench = Bench::new(seed);
        let action = if wander {
            Action::Behave(BehaviourSpec::Wander { speed: 100 })
        } else {
            Action::Move { direction: Direction::Left, speed: 100, duration_ms: 5_000 }
        };
        bench.send(&action, 0, Number::Next, 0)?;
        bench.happen(&Happening::Run(20))?;
        bench.happen(&Happening::Sensor(Sensor::Silent))?;
        bench.happen(&Happening::Run(15))?;
        prop_assert!(bench.robot.snapshot().wheels[1] > 0.0, "300 ms old is not older");
        bench.happen(&Happening::Run(1))?;
        prop_assert_eq!(bench.robot.snapshot().wheels, [0.0, 0.0]);
    }

    /// Outside references move the estimate alone: a robot at rest rests on, and is found there.
    #[test]
    fn fixes_move_no_wheel(
        seed in any::<u64>(),
        fixes in prop::collection::vec((-5.0_f32..5.0, -5.0_f32..5.0, -3.0_f32..3.0), 1..30),
    ) {
        let mut bench = Bench::new(seed);
        for (x, y, theta) in fixes {
            let pose = Pose { x, y, theta, sigma: 0.01 };
            // The first of the frame is adopted, then three that agree.
            for _ in 0..3 {
                bench.happen(&Happening::Fix { pose, age: 0 })?;
                let out = bench.turn(Duration::from_millis(20), None)?;
                prop_assert_eq!(out.duties, [0.0, 0.0]);
            }
            prop_assert_eq!(bench.state(), RobotState::Idle);
            let there = bench.robot.snapshot().pose;
            prop_assert!((there.x - x).hypot(there.y - y) < 0.1, "{:?}, not {} {}", there, x, y);
        }
    }

    /// Rule 6: no bytes make intake or control panic.
    #[test]
    fn no_bytes_do_harm(
        messages in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..1_200), 1..20),
    ) {
        let mut bench = Bench::new(1);
        for message in messages {
            bench.happen(&Happening::Bytes(message))?;
            bench.happen(&Happening::Run(1))?;
        }
    }
}

#[test]
fn link_loss_ends_motion_and_driving_does_not_resume() {
    let forward = Action::Move {
        direction: Direction::Forward,
        speed: 80,
        duration_ms: 10_000,
    };
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    for (action, afterwards) in [(forward, RobotState::Idle), (wander, RobotState::Moving)] {
        let mut bench = Bench::new(7);
        bench.happen(&Happening::Link(LinkHealth::Up)).expect("up");
        bench.send(&action, 0, Number::Next, 0).expect("sent");
        bench.happen(&Happening::Run(30)).expect("runs");
        assert_eq!(bench.state(), RobotState::Moving);
        let lost = Happening::Link(LinkHealth::Lost);
        bench.happen(&lost).expect("lost");
        bench.happen(&Happening::Run(1)).expect("runs");
        assert_eq!(bench.robot.snapshot().wheels, [0.0; 2]);
        assert_eq!(bench.state(), RobotState::Idle);
        bench.happen(&Happening::Link(LinkHealth::Up)).expect("up");
        bench.happen(&Happening::Run(100)).expect("runs");
        assert_eq!(bench.state(), afterwards, "{action:?}");
    }
}

#[test]
fn wander_gets_out_of_a_corner_and_slows_down_before_it() {
    let mut bench = Bench::new(3);
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 100 });
    bench.send(&wander, 0, Number::Next, 0).expect("sent");
    bench.happen(&Happening::Run(60)).expect("runs");
    let free = bench.robot.snapshot().wheels[0];
    let sees = |mm| Happening::Sensor(Sensor::Sees(Sight::Range(Millimeters(mm))));
    bench.happen(&sees(350)).expect("near");
    bench.happen(&Happening::Run(60)).expect("runs");
    assert_eq!(bench.state(), RobotState::Caution);
    assert!(bench.robot.snapshot().wheels[0] < free * 0.7);
    bench.happen(&sees(200)).expect("too near");
    bench.happen(&Happening::Run(10)).expect("runs");
    assert_eq!(bench.state(), RobotState::Avoiding);
    let [left, right] = bench.robot.snapshot().wheels;
    assert!(left * right < 0.0, "turns in place: {left} {right}");
    // It does not clear: both ways round are tried, and backing off.
    let mut backed = false;
    let mut sides = Vec::new();
    for _ in 0..2_000 {
        bench.happen(&Happening::Run(1)).expect("runs");
        let [left, right] = bench.robot.snapshot().wheels;
        backed |= left < 0.0 && right < 0.0;
        sides.push(left < right);
    }
    assert!(backed && sides.contains(&true) && sides.contains(&false));
    let clear = Happening::Sensor(Sensor::Sees(Sight::Clear));
    bench.happen(&clear).expect("clear");
    bench.happen(&Happening::Run(150)).expect("runs");
    assert_eq!(bench.state(), RobotState::Moving);
}
