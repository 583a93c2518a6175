//! Worlds that are gone on from, without a network: all but the links is the same in a live one.

use crawler_app::parameters::Parameter;
use crawler_protocol::{
    Action, BehaviourName, BehaviourSpec, ParameterValue, ParameterValues, Wheel,
};

use super::*;
use crate::run::Simulation;
use crate::world::{DropError, Dropped, Object, ObjectShape, Obstacle};

fn without_network(name: &str, robots: u32) -> Simulation {
    let scenario = Scenario::built_in(name).expect("there").with_robots(robots);
    Simulation::without_network(scenario, 7).expect("sound")
}

fn resume(kept: &Checkpoint) -> Simulation {
    let nowhere = BrokerAddress::default();
    let mut simulation =
        Simulation::again(kept, (Fleet::default(), Way::None), nowhere).expect("sound");
    simulation.go_on(kept);
    simulation
}

fn seconds(span: u64) -> Duration {
    Duration::from_secs(span)
}

fn set(simulation: &mut Simulation, robot: usize, name: &str, value: f32) {
    let mut values = ParameterValues::new();
    let name = heapless::String::try_from(name).expect("short");
    let pushed = values.push((name, ParameterValue::Number(value)));
    assert!(pushed.is_ok());
    simulation.submit(robot, Action::Set(values));
}

/// The first free place for a post beside a robot.
fn drop_somewhere(simulation: &mut Simulation) -> u32 {
    for place in 0..40 {
        let x = -1.0 + place as f32 * 0.05;
        match simulation.drop_in(Dropped::Obstacle(Obstacle::Circle { x, y: 0.3, r: 0.05 })) {
            Ok(item) => return item,
            Err(error) => assert!(matches!(error, DropError::OnRobot(_)), "{error}"),
        }
    }
    panic!("robots are everywhere");
}

#[test]
fn a_world_that_is_gone_on_from_is_where_it_was_and_its_robots_stand_idle() {
    let mut simulation = without_network("arena", 5);
    simulation.run_for(seconds(4));
    set(&mut simulation, 1, "safe_distance_mm", 725.0);
    simulation.run_for(seconds(3));
    simulation.remove(2);
    simulation.spawn().expect("there is room");
    let gone = drop_somewhere(&mut simulation);
    let item = drop_somewhere(&mut simulation);
    assert!(simulation.take_away(gone));
    let weak = Fault::MotorWeak {
        wheel: Wheel::Left,
        strength: 0.25,
    };
    simulation.inject(0, weak, Some(seconds(9))).expect("sound");
    simulation
        .inject(1, Fault::RangerDead, None)
        .expect("sound");
    simulation
        .inject(3, Fault::BatteryAt { charge: 0.5 }, None)
        .expect("sound");
    simulation.run_for(Duration::from_millis(2_345));
    let kept = simulation.keep();
    assert_eq!((kept.present(), kept.at()), (5, simulation.now()));
    assert!(kept.footprint() > 5 * 320);
    let before: Vec<_> = (0..6).map(|robot| simulation.observe(robot)).collect();
    let moving = before.iter().flatten().any(|seen| seen.speed.abs() > 0.05);
    assert!(moving, "they wander: {before:?}");
    // What happens afterwards is no part of it.
    simulation.run_for(seconds(5));
    assert!(simulation.take_away(item));
    simulation.heal(1);
    set(&mut simulation, 1, "safe_distance_mm", 400.0);
    simulation.run_for(seconds(1));

    let mut again = resume(&kept);
    assert_eq!(again.now(), kept.at());
    assert_eq!((again.seed(), again.robots(), again.present()), (7, 6, 5));
    assert_eq!(again.world().steps(), kept.at().as_micros() / 10_000);
    for (robot, seen) in before.iter().enumerate() {
        let mut seen = seen.expect("it was there");
        // Nothing drives, and nothing shines, before a program says so.
        (seen.duty, seen.lamp) = ([0, 0], false);
        // Whose watchdog bit is a matter of its program.
        seen.starvations = 0;
        assert_eq!(again.observe(robot), Some(seen), "robot {robot}");
        assert_eq!(again.id(robot), simulation.id(robot));
    }
    assert_eq!(
        again.pose(2),
        None,
        "it stays away, and its name is not given again"
    );
    let lying = again.world().dropped();
    assert_eq!(lying.iter().map(|one| one.id).collect::<Vec<_>>(), [item]);
    assert_eq!(again.second_hashes(), &simulation.second_hashes()[..9]);

    again.run_for(seconds(2));
    let parked: Vec<_> = (0..6).map(|robot| again.pose(robot)).collect();
    again.run_for(seconds(4));
    for robot in [0, 1, 3, 4, 5] {
        let program = again.robot(robot).expect("it runs");
        assert_eq!(
            program.snapshot().behaviour,
            BehaviourName::Manual,
            "{robot}"
        );
        assert_eq!(again.pose(robot), parked[robot], "robot {robot} stands");
    }
    let told = |world: &Simulation, robot: usize| {
        let program = world.robot(robot).expect("it runs");
        program.with_parameters(|all| all.number(Parameter::SafeDistance))
    };
    assert_eq!(told(&again, 1), 725.0);
    assert_eq!(again.boots(1), 2);
    assert_eq!(
        again.robot(1).expect("it runs").boot().count,
        2,
        "as after a power cut"
    );
    assert!(again.robot(1).expect("it runs").snapshot().fault.is_some());
    assert!(again.robot(4).expect("it runs").snapshot().fault.is_none());
    // The weak motor is mended when its time is over, and no earlier.
    let left = |world: &Simulation| world.keep().faults;
    assert_eq!(left(&again).len(), 3);
    again.run_for(seconds(1));
    assert_eq!(left(&again).len(), 2);
    // They take orders as ever, and the next number is the next.
    again.submit(4, Action::Behave(BehaviourSpec::Wander { speed: 60 }));
    again.run_for(seconds(5));
    assert_ne!(again.pose(4), parked[4]);
    assert_eq!(drop_somewhere(&mut again), item + 1);
    let spawned = again.spawn().expect("there is room");
    assert_eq!(
        again
            .id(spawned)
            .map(|id| id.as_str().to_owned())
            .as_deref(),
        Some("sim-0007")
    );
}

#[test]
fn what_is_gone_on_from_twice_goes_the_same_way_and_movers_and_timeline_go_on() {
    let mut simulation = without_network("dynamic-environment", 2);
    simulation.run_for(Duration::from_millis(12_340));
    let kept = simulation.keep();
    let mover = simulation.world().mover(0).expect("one");
    let (mut one, mut other) = (resume(&kept), resume(&kept));
    assert_eq!(one.world().mover(0), Some(mover));
    for world in [&mut one, &mut other] {
        world.submit_all(Action::Behave(BehaviourSpec::Wander { speed: 60 }));
        world.run_for(seconds(6));
    }
    assert_ne!(one.world().mover(0), Some(mover));
    assert_eq!(one.history_hash(), other.history_hash());
    // Its faults come when they would have come.
    let mut simulation = without_network("resilience", 4);
    simulation.run_for(seconds(11));
    let broken = |world: &Simulation| world.keep().faults.len();
    assert_eq!(broken(&simulation), 0);
    let mut early = resume(&simulation.keep());
    early.run_for(seconds(2));
    assert_eq!(broken(&early), 1, "the first one is due at 12 s, for 5 s");
    let mut late = resume(&early.keep());
    assert_eq!(broken(&late), 1);
    // The second one comes at 15 s.
    late.run_for(Duration::from_millis(3_900));
    assert_eq!(broken(&late), 2);
    late.run_for(Duration::from_millis(200));
    assert_eq!(broken(&late), 1);
}

#[test]
fn a_robot_without_power_has_none_afterwards_either_and_starts_when_it_is_back() {
    let mut simulation = without_network("empty", 2);
    simulation.run_for(seconds(2));
    simulation
        .inject(0, Fault::BrownOut, Some(seconds(5)))
        .expect("sound");
    simulation.run_for(seconds(1));
    assert!(!simulation.observe(0).expect("there").powered);
    let mut again = resume(&simulation.keep());
    assert!(!again.observe(0).expect("there").powered);
    let boots = again.boots(0);
    again.run_for(seconds(2));
    assert!(!again.observe(0).expect("there").powered);
    assert_eq!(again.boots(0), boots);
    again.run_for(seconds(3));
    assert!(again.observe(0).expect("there").powered);
    assert_eq!(again.boots(0), boots + 1);
    assert_eq!(again.boots(1), 2);
}

/// Each start without a confirmation counts, and a program is given up after a few.
#[test]
fn a_robot_without_power_uses_up_no_start_of_its_new_program() {
    let mut simulation = without_network("empty", 1);
    simulation.run_for(seconds(2));
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    let bundle = crawler_bundle::Bundle::new("9.0.0", "new");
    crate::devices::install(&mut chip.borrow_mut(), &bundle, 3_000, 0);
    simulation.submit(0, Action::Reboot);
    simulation.run_for(seconds(3));
    let firmware = |world: &Simulation| world.robot(0).expect("there").config().firmware;
    assert_eq!(firmware(&simulation), "9.0.0");
    simulation
        .inject(0, Fault::BrownOut, Some(seconds(20)))
        .expect("sound");
    simulation.run_for(seconds(1));
    let boots = simulation.boots(0);
    for _ in 0..6 {
        simulation = resume(&simulation.keep());
        simulation.run_for(seconds(1));
        assert!(!simulation.observe(0).expect("there").powered);
    }
    assert_eq!(simulation.boots(0), boots);
    simulation.run_for(seconds(15));
    assert!(simulation.observe(0).expect("there").powered);
    assert_eq!(
        (firmware(&simulation), simulation.boots(0)),
        ("9.0.0", boots + 1)
    );
}

#[test]
fn what_has_been_destroyed_and_used_since_is_not_destroyed_again() {
    let mut simulation = without_network("empty", 1);
    simulation.run_for(seconds(1));
    simulation
        .inject(0, Fault::FlashNoise { seed: 3 }, None)
        .expect("sound");
    simulation
        .inject(0, Fault::BatteryAt { charge: 0.4 }, None)
        .expect("sound");
    simulation.run_for(seconds(1));
    // The program finds noise at its next boot, and makes do.
    simulation.submit(0, Action::Reboot);
    simulation.run_for(seconds(6));
    set(&mut simulation, 0, "safe_distance_mm", 725.0);
    simulation.run_for(seconds(20));
    let charge = simulation.observe(0).expect("there").charge;
    assert!(charge < 0.4);
    let mut again = resume(&simulation.keep());
    assert_eq!(again.observe(0).expect("there").charge, charge);
    again.run_for(seconds(3));
    let program = again.robot(0).expect("it runs");
    let kept = program.with_parameters(|all| all.number(Parameter::SafeDistance));
    assert_eq!(kept, 725.0);
}

#[test]
fn robots_that_touch_a_wall_or_each_other_find_their_places_again() {
    let mut simulation = without_network("empty", 1);
    let pose = crate::world::Pose::new;
    simulation.remove(0);
    for (x, y, theta) in [
        (0.0, 0.0, 0.0),
        (0.3, 0.0, core::f32::consts::PI),
        (2.8, 2.0, 0.0),
    ] {
        simulation.spawn_at(pose(x, y, theta)).expect("free");
    }
    let ball = Object {
        shape: ObjectShape::Ball,
        x: 2.0,
        y: -2.0,
        size: 0.2,
        colour: crate::world::Colour::Red,
    };
    simulation.drop_in(Dropped::Object(ball)).expect("free");
    simulation.run_for(seconds(1));
    // Stuck on: whatever the program wants, they press on.
    for robot in 1..4 {
        for wheel in [Wheel::Left, Wheel::Right] {
            let fault = Fault::MotorStuckOn { wheel };
            simulation.inject(robot, fault, None).expect("sound");
        }
    }
    simulation.run_for(seconds(3));
    let touching = simulation.observe(3).expect("there");
    assert!(touching.contacts >= 1, "{touching:?}");
    let again = resume(&simulation.keep());
    for robot in 0..4 {
        assert_eq!(again.pose(robot), simulation.pose(robot));
    }
    assert_eq!(again.world().arena(), simulation.world().arena());
}
