//! Battery, brown-out, reset, watchdog.

use crawler_hal::System;

use super::*;
use crate::faults::{Fault, FaultError, FaultRange, Wheel};

#[test]
fn the_battery_sags_under_load_recovers_and_drains() {
    let mut bench = TestWorld::plain();
    bench.add(-4.0, 0.0, 0.0);
    bench.step();
    let rest = bench.see(0);
    bench.drive(0, 255, 255);
    bench.step();
    let load = bench.see(0);
    assert!(
        load.battery.0 + 150 < rest.battery.0,
        "starting draws the most: {rest:?} {load:?}"
    );
    bench.steps(300);
    bench.drive(0, 0, 0);
    bench.step();
    let after = bench.see(0);
    assert!(after.battery > load.battery && after.battery <= rest.battery);
    assert!(after.charge < rest.charge);
}

#[test]
fn charge_is_used_up_as_the_current_says() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 0.0, 0.0);
    let before = bench.see(0).charge;
    bench.steps(6_000);
    // 0.15 A for 60 s out of 2 Ah.
    let used = before - bench.see(0).charge;
    let want = 0.15 * 60.0 / (2.0 * 3_600.0);
    assert!((used - want).abs() < 0.01 * want, "{used} {want}");
}

#[test]
fn an_empty_battery_ends_everything() {
    let mut bench = TestWorld::plain();
    let robot = bench.add(0.0, 0.0, 0.0);
    bench.drive(0, 255, 255);
    bench.steps(50);
    bench
        .world
        .inject(robot, Fault::BatteryAt { charge: 0.0 })
        .expect("a charge");
    bench.step();
    assert_eq!(bench.world.take_events(), vec![BodyEvent::PowerLost(robot)]);
    let seen = bench.see(0);
    assert!(!seen.powered && seen.duty == [0, 0] && seen.battery.0 == 0);
    bench.drive(0, 255, 255);
    bench.steps(300);
    assert_eq!(
        bench.see(0).duty,
        [0, 0],
        "a dead controller drives nothing"
    );
    assert!(bench.see(0).speed == 0.0);
    assert!(bench.world.boot(robot, ResetCause::BrownOut).is_none());
    assert!(bench.world.take_events().is_empty());
}

#[test]
fn a_bad_contact_browns_out_and_comes_back_with_its_cause() {
    let mut bench = TestWorld::plain();
    let robot = bench.add(0.0, 0.0, 0.0);
    let sag = Fault::BatterySag { ohm: 40.0 };
    bench.world.inject(robot, sag).expect("a resistance");
    bench.step();
    assert_eq!(bench.world.take_events(), vec![BodyEvent::PowerLost(robot)]);
    bench.world.heal(robot);
    bench.step();
    assert_eq!(
        bench.world.take_events(),
        vec![BodyEvent::Reset(robot, ResetCause::BrownOut)]
    );
    let parts = bench
        .world
        .boot(robot, ResetCause::BrownOut)
        .expect("powered");
    assert_eq!(parts.system.reset_cause(), ResetCause::BrownOut);
    bench.drive(0, 255, 255);
    assert_eq!(
        bench.see(0).duty,
        [0, 0],
        "the devices of the last life are disconnected"
    );
    bench.parts[0] = parts;
    bench.drive(0, 255, -255);
    assert_eq!(bench.see(0).duty, [255, -255]);
}

#[test]
fn a_starved_watchdog_bites_once_and_a_fed_one_never() {
    let mut bench = TestWorld::plain();
    let starved = bench.add(0.0, 0.0, 0.0);
    bench.add(1.0, 0.0, 0.0);
    bench.add(2.0, 0.0, 0.0);
    bench.parts[0].system.feed_watchdog();
    for _ in 0..300 {
        bench.parts[1].system.feed_watchdog();
        bench.step();
    }
    assert_eq!(
        bench.world.take_events(),
        vec![BodyEvent::Reset(starved, ResetCause::Watchdog)]
    );
    let bites: Vec<u32> = (0..3).map(|i| bench.see(i).starvations).collect();
    assert_eq!(bites, [1, 0, 0], "the third was never armed");
}

#[test]
fn a_program_that_asks_for_a_reset_gets_one() {
    let mut bench = TestWorld::plain();
    let robot = bench.add(0.0, 0.0, 0.0);
    let mut system = bench.parts.remove(0).system;
    assert_eq!(system.reset_cause(), ResetCause::PowerOn);
    bench.scheduler.spawn(async move {
        system.reset().await;
    });
    bench.step();
    assert_eq!(
        bench.world.take_events(),
        vec![BodyEvent::Reset(robot, ResetCause::Software)]
    );
    assert_eq!(bench.scheduler.tasks(), 1, "the future never completes");
}

#[test]
fn a_weak_motor_pulls_to_its_side_until_it_is_mended() {
    let mut bench = TestWorld::plain();
    let robot = bench.add(-4.0, 0.0, 0.0);
    let weak = Fault::MotorWeak {
        wheel: Wheel::Left,
        strength: 0.8,
    };
    bench.world.inject(robot, weak).expect("a strength");
    bench.drive(0, 200, 200);
    bench.steps(50);
    assert!(bench.see(0).pose.theta > 0.05);
    bench.world.heal(robot);
    bench.steps(100);
    assert!(bench.see(0).turn.abs() < 1e-3);
}

#[test]
fn faults_out_of_range_are_refused_and_change_nothing() {
    let mut bench = TestWorld::plain();
    let robot = bench.add(0.0, 0.0, 0.0);
    let before = bench.world.hash();
    for fault in [
        Fault::LineNoise { flips: f32::NAN },
        Fault::LineNoise { flips: 1.5 },
        Fault::MotorWeak {
            wheel: Wheel::Right,
            strength: -0.1,
        },
        Fault::BatterySag { ohm: f32::INFINITY },
        Fault::BatteryAt { charge: 2.0 },
    ] {
        assert_eq!(
            bench.world.inject(robot, fault),
            Err(FaultError::Range(FaultRange))
        );
    }
    assert_eq!(bench.world.hash(), before);
}
