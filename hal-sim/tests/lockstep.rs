//! The real robot program, end to end, in virtual time.

use crate::common::{Answers, collect, duty, forward, lockstep, settle, travel, wander};
use crawler_app::controller::{FAILSAFE, HOLD};
use crawler_app::parameters::Parameter;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{
    Action, ParameterValue, ParameterValues, ResponseStatus, StatusMessage, Topic,
};
use crawler_sim::faults::Fault;
use crawler_sim::net::lockstep::Cut;
use crawler_sim::run::Simulation;
use crawler_sim::tools::bench::{self, Meter};

fn ms(value: u64) -> Instant {
    Instant::from_millis(value)
}

#[test]
fn fifty_robots_wander_for_a_minute_without_passing_through_anything() {
    let robots = 50;
    let mut simulation = lockstep("arena", robots, 7);
    settle(&mut simulation);
    let travelled = travel(&mut simulation, 600);
    let contacts: u32 = (0..robots as usize)
        .map(|robot| simulation.observe(robot).unwrap().contacts)
        .sum();
    let least = travelled.iter().copied().fold(f32::MAX, f32::min);
    println!("{contacts} contacts, least way {least} m");
    // That nothing was passed through was looked at in every step. Touching is another matter: the
    // beam is narrow, so robots brush each other and slanted walls, less than twice a minute each.
    assert!(contacts < 2 * robots, "{contacts} contacts");
    assert!(least > 1.0, "one robot went only {least} m");
    assert_eq!(simulation.network().unwrap().take_faults(), []);
    assert_eq!(simulation.network().unwrap().connected(), robots as usize);
    for robot in 0..robots as usize {
        assert_eq!(simulation.boots(robot), 1);
        let seen = simulation.observe(robot).unwrap();
        assert_eq!((seen.starvations, seen.flash_violations), (0, 0));
    }
}

#[test]
fn stop_ends_all_duty_within_one_control_period_of_its_receipt() {
    let mut simulation = lockstep("arena", 10, 3);
    settle(&mut simulation);
    simulation.run_for(Duration::from_millis(4_007));
    let driving = |simulation: &Simulation| {
        (0..10)
            .filter(|&robot| duty(simulation, robot) != [0, 0])
            .count()
    };
    assert!(driving(&simulation) >= 8, "most should be under way by now");
    simulation.submit_all(Action::Stop);
    // Latency and jitter of the link take at most 5 ms.
    simulation.run_for(Duration::from_millis(5 + 20));
    assert_eq!(driving(&simulation), 0);
    let now = simulation.now();
    for step in 1..=500 {
        simulation.run_until(now + Duration::from_millis(step * 10));
        assert_eq!(driving(&simulation), 0, "moved again after stop");
    }
    let mut answers = Answers::new();
    collect(&simulation, &mut answers);
    let completed = answers
        .values()
        .filter(|statuses| **statuses == [ResponseStatus::Completed]);
    // One for the scenario's command, one for the stop.
    assert_eq!(completed.count(), 20);
}

#[test]
fn a_lost_link_ends_driving() {
    for (cut, within_ms) in [(Cut::Radio, 260), (Cut::Silent, 8_300)] {
        let mut simulation = lockstep("empty", 1, 5);
        settle(&mut simulation);
        // Turning in place needs no room and is not held up by what is ahead.
        simulation.submit(
            0,
            Action::Move {
                direction: crawler_protocol::Direction::Left,
                speed: 40,
                duration_ms: 10_000,
            },
        );
        simulation.run_for(Duration::from_millis(400));
        assert_ne!(duty(&simulation, 0), [0, 0]);
        simulation.cut(0, cut);
        simulation.run_for(Duration::from_millis(within_ms));
        assert_eq!(duty(&simulation, 0), [0, 0], "{cut:?}");
    }
}

/// However slow the ramp, and however the last word falls between two control periods.
#[test]
fn wheels_stand_half_a_second_after_the_last_word_of_their_controller() {
    let step = Duration::from_millis(1);
    let drive = Action::Drive { v: 0.0, w: 4.0 };
    let mut slowest = Duration::from_millis(0);
    for (ramp, seed) in [1.0, 5.0, 20.0].into_iter().flat_map(|r| [(r, 5), (r, 6)]) {
        let mut simulation = lockstep("empty", 1, seed);
        settle(&mut simulation);
        let name = heapless::String::try_from("ramp_step").unwrap();
        let mut values = ParameterValues::new();
        values.push((name, ParameterValue::Number(ramp))).unwrap();
        simulation.submit(0, Action::Set(values));
        for phase in 0..7 {
            for _ in 0..12 {
                simulation.submit(0, drive.clone());
                simulation.run_for(Duration::from_millis(150));
                assert_ne!(duty(&simulation, 0), [0, 0], "ramp {ramp}");
            }
            simulation.run_for(step * (phase * 3));
            simulation.submit(0, drive.clone());
            // Its way is up to 5 ms long. Then the link is cut, and the robot does not know it.
            simulation.run_for(step * 10);
            simulation.cut(0, Cut::Silent);
            let heard = simulation.robot(0).unwrap().tally().motion.unwrap();
            assert!(simulation.now() - heard <= step * 10, "the last word came");
            let alone = loop {
                simulation.run_for(step);
                let alone = simulation.now() - heard;
                if duty(&simulation, 0) == [0, 0] {
                    break alone;
                }
                assert!(alone <= FAILSAFE, "ramp {ramp}, phase {phase}: {alone:?}");
            };
            assert!(alone >= HOLD, "ramp {ramp}, phase {phase}: {alone:?}");
            slowest = slowest.max(alone);
            simulation.cut(0, Cut::None);
            simulation.run_for(Duration::from_secs(1));
            assert_eq!(duty(&simulation, 0), [0, 0]);
        }
    }
    println!("after {} ms at the latest", slowest.as_millis());
}

#[test]
fn every_answer_arrives_exactly_once_across_a_partition() {
    for seed in 0..6 {
        let robots = 8_usize;
        let mut simulation = lockstep("empty", robots as u32, seed);
        settle(&mut simulation);
        let mut answers = Answers::new();
        let mut given = Vec::new();
        for round in 0..4 {
            let turn = Action::Move {
                direction: crawler_protocol::Direction::Left,
                speed: 30,
                duration_ms: 600,
            };
            given.push(simulation.submit_all(turn));
            // Cut at another moment of the command's life in each round: before it arrives, on
            // the way of its first answer, and later.
            simulation.run_for(Duration::from_millis([1, 4, 24, 606][round]));
            let cut = if seed % 2 == 0 {
                Cut::Silent
            } else {
                Cut::Radio
            };
            for robot in 0..robots {
                simulation.cut(robot, cut);
            }
            // Long enough for both ends to give the connection up, shorter than the session.
            simulation.run_for(Duration::from_secs(14));
            for robot in 0..robots {
                simulation.cut(robot, Cut::None);
            }
            simulation.run_for(Duration::from_secs(20));
            collect(&simulation, &mut answers);
        }
        for robot in 0..robots {
            let id = simulation.id(robot).unwrap().as_str().to_owned();
            for (round, &seq) in given.iter().enumerate() {
                let mut statuses = answers.get(&(id.clone(), seq)).cloned().unwrap_or_default();
                if round < 2 {
                    // The acknowledgement of the command itself was lost, so the broker sent the
                    // command again, and a repeated command is answered from memory.
                    statuses.dedup();
                }
                let whole = match statuses.as_slice() {
                    [ResponseStatus::Accepted, last] => last.is_final(),
                    [only] => only.is_final(),
                    _ => false,
                };
                assert!(whole, "seed {seed}, {id}, command {seq}: {statuses:?}");
            }
        }
    }
}

#[test]
fn without_a_ranger_nobody_wanders() {
    let mut simulation = lockstep("empty", 1, 2);
    simulation.inject(0, Fault::RangerDead, None).unwrap();
    settle(&mut simulation);
    simulation.submit(0, wander());
    simulation.submit(0, forward(50, 2_000));
    for _ in 0..300 {
        simulation.run_for(Duration::from_millis(10));
        assert_eq!(duty(&simulation, 0), [0, 0]);
    }
    // It dies under way: the last reading is good for 300 ms.
    simulation.heal(0);
    simulation.run_for(Duration::from_secs(3));
    simulation.submit(0, wander());
    simulation.run_for(Duration::from_secs(1));
    assert_ne!(duty(&simulation, 0), [0, 0]);
    simulation.inject(0, Fault::RangerDead, None).unwrap();
    simulation.run_for(Duration::from_millis(700));
    for _ in 0..300 {
        simulation.run_for(Duration::from_millis(10));
        assert_eq!(duty(&simulation, 0), [0, 0]);
    }
}

#[test]
fn parameters_and_pose_survive_a_reboot_and_the_boot_is_counted() {
    let mut simulation = lockstep("empty", 1, 2);
    settle(&mut simulation);
    let mut values = ParameterValues::new();
    let name = heapless::String::try_from("safe_distance_mm").unwrap();
    values.push((name, ParameterValue::Number(725.0))).unwrap();
    simulation.submit(0, Action::Set(values));
    simulation.run_for(Duration::from_secs(1));
    let before = simulation.observe(0).unwrap().pose;
    simulation.submit(0, Action::Reboot);
    simulation.run_for(Duration::from_secs(8));
    assert_eq!(simulation.boots(0), 2);
    let robot = simulation.robot(0).unwrap();
    assert_eq!(robot.boot().count, 2);
    assert_eq!(robot.boot().cause, crawler_hal::ResetCause::Software);
    let kept = robot.with_parameters(|p| p.number(Parameter::SafeDistance));
    assert_eq!(kept, 725.0);
    assert_eq!(simulation.observe(0).unwrap().pose, before);
    let statuses: Vec<_> = simulation
        .network()
        .unwrap()
        .take_record()
        .into_iter()
        .filter(|p| {
            matches!(
                Topic::parse(simulation.fleet(), &p.topic),
                Ok(Topic::Status(_))
            )
        })
        .map(|p| StatusMessage::from_json(&p.payload).unwrap())
        .collect();
    // Up, the will of the connection that the reset tore, up again.
    let told: Vec<_> = statuses.iter().map(|s| (s.online, s.boot.count)).collect();
    assert_eq!(told.first(), Some(&(true, 1)));
    assert!(told.contains(&(false, 1)));
    assert_eq!(told.last(), Some(&(true, 2)));
}

#[test]
fn duty_changes_only_at_control_steps_twenty_milliseconds_apart() {
    let mut simulation = lockstep("arena", 3, 9);
    settle(&mut simulation);
    let mut last: Vec<_> = (0..3).map(|robot| duty(&simulation, robot)).collect();
    let mut changes = 0;
    for at in 5_501..15_000_u64 {
        simulation.run_until(ms(at));
        for (robot, last) in last.iter_mut().enumerate() {
            let duty = duty(&simulation, robot);
            if duty != *last {
                changes += 1;
                assert_eq!(at % 20, 0, "a change at {at} ms");
                *last = duty;
            }
        }
    }
    assert!(changes > 100, "only {changes} changes");
}

#[test]
fn physics_runs_in_whole_steps_up_to_the_present() {
    let mut simulation = lockstep("arena", 2, 9);
    for at in [0, 3, 9, 10, 11, 29, 30, 1_234] {
        simulation.run_until(ms(at));
        assert_eq!(simulation.world().steps(), at / 10, "at {at} ms");
        assert_eq!(simulation.now(), ms(at));
    }
}

#[test]
fn two_robots_of_one_process_differ() {
    let mut simulation = lockstep("arena", 2, 1);
    simulation.run_until(ms(20_000));
    let (first, second) = (
        simulation.observe(0).unwrap(),
        simulation.observe(1).unwrap(),
    );
    assert_ne!(first.pose, second.pose);
    assert_ne!(first.battery, second.battery);
    assert_ne!(simulation.id(0), simulation.id(1));
    assert_eq!(simulation.id(0).unwrap().as_str(), "sim-0001");
}

#[test]
fn a_removed_robot_is_gone_and_the_others_go_on() {
    let mut simulation = lockstep("arena", 3, 4);
    settle(&mut simulation);
    simulation.remove(1);
    simulation.run_for(Duration::from_secs(5));
    assert_eq!(simulation.present(), 2);
    assert!(!simulation.observe(1).unwrap().present);
    assert_eq!(simulation.network().unwrap().connected(), 2);
    let added = simulation.spawn().unwrap();
    simulation.run_for(Duration::from_secs(6));
    assert_eq!(simulation.id(added).unwrap().as_str(), "sim-0004");
    assert_eq!(simulation.network().unwrap().connected(), 3);
}

#[test]
fn without_a_network_robots_wander_and_can_be_commanded() {
    let mut simulation =
        Simulation::without_network(crate::common::scenario("arena", 12), 8).unwrap();
    // Boot, and at most one period until the time is told.
    simulation.run_until(ms(5_500));
    for robot in 0..12 {
        let told = simulation.robot(robot).unwrap().unix_ms(simulation.now());
        assert_eq!(told, Some(simulation.unix_ms()));
    }
    for (robot, travelled) in travel(&mut simulation, 300).iter().enumerate() {
        assert!(*travelled > 0.5, "{robot} went only {travelled} m");
    }
    simulation.submit_all(Action::Stop);
    simulation.run_for(Duration::from_millis(20));
    assert!((0..12).all(|robot| duty(&simulation, robot) == [0, 0]));
    // The clock is set again after a boot.
    simulation.submit(3, Action::Reboot);
    simulation.run_for(Duration::from_secs(8));
    assert_eq!(simulation.boots(3), 2);
    let turn = Action::Move {
        direction: crawler_protocol::Direction::Left,
        speed: 40,
        duration_ms: 2_000,
    };
    simulation.submit(3, turn);
    simulation.run_for(Duration::from_millis(400));
    assert_ne!(duty(&simulation, 3), [0, 0]);
}

#[test]
fn without_a_network_runs_are_repeatable() {
    let run = |seed| {
        let scenario = crate::common::scenario("arena", 5);
        let mut simulation = Simulation::without_network(scenario, seed).unwrap();
        simulation.run_until(ms(20_000));
        simulation.history_hash()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn benches_measure_robots_that_move() {
    struct Still;
    impl Meter for Still {
        fn cpu_s(&self) -> f64 {
            0.0
        }
        fn memory(&self) -> Option<u64> {
            None
        }
    }
    let (warm_up, span) = (Duration::from_secs(8), Duration::from_secs(5));
    for measure in [bench::measure, bench::measure_without_network] {
        let scenario = crate::common::scenario("arena", 20);
        let figures = measure(scenario, 1, warm_up, span, &Still).unwrap();
        assert_eq!((figures.robots, figures.virtual_s), (20, 5.0));
        assert!(figures.moving >= 15, "only {} move", figures.moving);
    }
}

#[test]
fn without_a_network_halts_and_settings_still_work() {
    let mut simulation =
        Simulation::without_network(crate::common::scenario("empty", 1), 1).unwrap();
    simulation.run_until(ms(1_000));
    let mut values = ParameterValues::new();
    let name = heapless::String::try_from("safe_distance_mm").unwrap();
    values.push((name, ParameterValue::Number(725.0))).unwrap();
    simulation.submit(0, Action::Set(values));
    simulation.submit(0, Action::Estop);
    simulation.run_for(Duration::from_secs(1));
    let robot = simulation.robot(0).unwrap();
    assert_eq!(
        robot.with_parameters(|p| p.number(Parameter::SafeDistance)),
        725.0
    );
    assert_eq!(robot.snapshot().state, crawler_protocol::RobotState::Error);
}
