//! How a robot moves when nothing is in its way.

use super::*;
use crate::world::geometry::wrap_any;

#[test]
fn alike_wheels_drive_straight_and_mirrored_duties_drive_mirrored() {
    let mut bench = TestWorld::plain();
    bench.add(-4.0, 0.0, 0.0);
    bench.add(0.0, -2.0, 0.0);
    bench.add(0.0, 2.0, 0.0);
    bench.drive(0, 200, 200);
    bench.drive(1, 200, 150);
    bench.drive(2, 150, 200);
    bench.steps(150);
    let straight = bench.see(0).pose;
    assert!(straight.x > -3.5, "it moves: {straight:?}");
    assert!(straight.y == 0.0 && straight.theta == 0.0, "{straight:?}");
    let (right, left) = (bench.see(1).pose, bench.see(2).pose);
    assert!(left.theta > 0.1, "the faster right wheel turns it left");
    assert!((right.x - left.x).abs() < 1e-5, "{right:?} {left:?}");
    assert!((right.y + left.y).abs() < 1e-5);
    assert!((right.theta + left.theta).abs() < 1e-6);
}

#[test]
fn forward_and_backward_are_the_same_but_for_the_sign() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 1.0, 0.0);
    bench.add(0.0, -1.0, 0.0);
    bench.drive(0, 180, 180);
    bench.drive(1, -180, -180);
    bench.steps(100);
    assert!(bench.see(0).speed > 0.2);
    assert!((bench.see(0).speed + bench.see(1).speed).abs() < 1e-6);
    assert!((bench.see(0).pose.x + bench.see(1).pose.x).abs() < 1e-5);
}

#[test]
fn a_turn_in_place_turns_by_the_speed_of_the_wheels_over_the_track() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 0.0, 0.0);
    bench.drive(0, -255, 255);
    bench.steps(100);
    let seen = bench.see(0);
    assert!(seen.pose.x.abs() < 1e-6 && seen.pose.y.abs() < 1e-6);
    let parameters = bench.world.parameters();
    let rim = parameters
        .chassis
        .speed_at(f32::from(seen.battery.0) * 1e-3);
    let turn = 2.0 * rim / parameters.chassis.track_m;
    assert!((seen.turn - turn).abs() < 0.02 * turn, "{seen:?}, {turn}");
    let before = seen.pose.theta;
    bench.step();
    let turned = wrap_any(bench.see(0).pose.theta - before);
    assert!((turned - seen.turn * 0.01).abs() < 1e-3);
}

#[test]
fn without_duty_every_robot_comes_to_a_full_stop_and_stays_there() {
    for (in1, in2, longest) in [(false, false, 150), (true, true, 150), (true, false, 150)] {
        let mut bench = TestWorld::plain();
        bench.add(0.0, 0.0, 0.3);
        bench.drive(0, 255, 255);
        bench.steps(100);
        let port = &mut bench.parts[0].left;
        port.in1.set_state(in1.into()).expect("infallible");
        port.in2.set_state(in2.into()).expect("infallible");
        let BodyParts { left, right, .. } = &mut bench.parts[0];
        for port in [left, right] {
            port.enable.set_duty_cycle(0).expect("zero is a duty");
        }
        bench.steps(longest);
        let stopped = bench.see(0);
        assert!(stopped.speed == 0.0 && stopped.turn == 0.0, "{stopped:?}");
        bench.steps(100);
        assert_eq!(bench.see(0).pose, stopped.pose);
    }
}

#[test]
fn a_robot_stops_in_the_way_that_its_shorted_motors_and_friction_make() {
    // Wheels that do not slide, however hard they brake.
    let mut parameters = alike();
    parameters.chassis.grip = 1.5;
    for duty in [0, 64, 128, 255_u8] {
        let mut bench = TestWorld::new(Arena::empty(10.0, 10.0), parameters, 1);
        bench.add(-3.0, 0.0, 0.0);
        bench.drive(0, 255, 255);
        bench.steps(150);
        let from = bench.see(0);
        let BodyParts { left, right, .. } = &mut bench.parts[0];
        for port in [left, right] {
            port.in1.set_high().expect("infallible");
            port.in2.set_high().expect("infallible");
            port.enable.set_duty_cycle(duty.into()).expect("a duty");
        }
        bench.steps(200);
        let way = bench.see(0).pose.x - from.pose.x;
        // A shorted motor brakes by its own voltage, for the share of time in which it is shorted;
        // grease and dry friction do the rest: m · dv/dt = −d · v − f.
        let chassis = &parameters.chassis;
        let shorted = (1.0 - chassis.drag_share) * f32::from(duty) / 255.0;
        let d = chassis.damping() * (chassis.drag_share + shorted);
        let f = chassis.running_v * chassis.force_per_amp / chassis.winding_ohm;
        let m = chassis.mass_kg * 0.5 + chassis.rotor_kg;
        let time = m / d * (1.0 + from.speed * d / f).ln();
        let want = m / d * from.speed - f / d * time;
        assert!((way - want).abs() < 0.001 * want, "{duty}: {way}, {want}");
    }
}

#[test]
fn stiction_holds_a_standing_wheel_that_would_go_on_turning() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 1.0, 0.0);
    bench.add(0.0, -1.0, 0.0);
    // 0.118 · 6.8 V = 0.80 V: between friction and stiction.
    bench.drive(0, 30, 30);
    bench.drive(1, 120, 120);
    bench.steps(50);
    bench.drive(1, 30, 30);
    bench.steps(300);
    assert!(bench.see(0).speed == 0.0, "it never started");
    let (seen, want) = (bench.see(1), settled(&bench, 1, 30));
    assert!(want > 0.01 && (seen.speed - want).abs() < 2e-4, "{seen:?}");
    bench.drive(0, 60, 60);
    bench.steps(50);
    assert!(bench.see(0).speed > 0.05);
}

#[test]
fn the_motor_lags_by_its_time_constant() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 0.0, 0.0);
    bench.drive(0, 200, 200);
    bench.steps(9);
    let at_tau = bench.see(0).speed;
    bench.steps(90);
    let share = at_tau / bench.see(0).speed;
    // 1 − 1/e, less what the sagging battery costs on the way.
    assert!((0.60..0.68).contains(&share), "{share}");
}

#[test]
fn a_heading_stays_within_one_turn() {
    let mut bench = TestWorld::plain();
    bench.add(0.0, 0.0, 40.0);
    bench.drive(0, 255, -255);
    for _ in 0..500 {
        bench.step();
        assert!(bench.see(0).pose.theta.abs() <= core::f32::consts::PI);
    }
}

/// Speed at which a robot comes to drive with this duty, by the dead band and the top speed at the
/// voltage that its pack has.
fn settled(bench: &TestWorld, robot: usize, duty: u8) -> f32 {
    let chassis = &bench.world.parameters().chassis;
    let supply_v = f32::from(bench.see(robot).battery.0) * 1e-3;
    let band = chassis.dead_band(supply_v);
    chassis.speed_at(supply_v) * (f32::from(duty) / 255.0 - band) / (1.0 - band)
}

#[test]
fn settled_speeds_follow_the_dead_band_and_the_top_speed() {
    for duty in [60, 90, 128, 200, 255_u8] {
        let mut bench = TestWorld::plain();
        bench.add(-4.0, 0.0, 0.0);
        bench.drive(0, duty.into(), duty.into());
        bench.steps(300);
        let (seen, want) = (bench.see(0), settled(&bench, 0, duty));
        assert!((seen.speed - want).abs() < 2e-4, "{duty}: {seen:?}, {want}");
    }
    let chassis = Parameters::default().chassis;
    assert!(chassis.dead_band(1.0) == 1.0, "too little for any duty");
}
