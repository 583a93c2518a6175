//! Robots on a radio that is not everywhere and not for them alone.

use crate::common::{Answers, collect, duty, forward, settle};
use crawler_hal::Duration;
use crawler_protocol::{Action, Direction, ResponseStatus, StatusMessage, Telemetry, Topic};
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use crawler_sim::world::Pose;

fn simulation(text: &str, seed: u64) -> Simulation {
    let scenario = Scenario::parse(text).unwrap();
    let simulation = Simulation::lockstep(scenario, seed).unwrap();
    simulation.network().unwrap().record(200_000);
    simulation
}

#[test]
fn a_robot_that_drives_out_of_range_stops_and_says_how_weak_the_signal_got() {
    let text = r#"
        name = "hall"
        robots = 0
        arena = { width = 30.0, height = 4.0 }
        [parameters.radio]
        shadowing_db = 0.0
        fading_db = 0.0
        [[radio.access_points]]
        x = -14.0
        y = 0.0
        attenuation_db = 40.0
    "#;
    let mut simulation = simulation(text, 3);
    let start = Pose::new(-10.0, 0.0, 0.0);
    simulation.spawn_at(start).unwrap();
    settle(&mut simulation);
    assert_eq!(simulation.network().unwrap().connected(), 1);
    simulation.submit(0, forward(100, 10_000));
    simulation.run_for(Duration::from_secs(40));
    // −89.6 dBm is what it takes: 8.5 m from the access point.
    let x = simulation.observe(0).unwrap().pose.x;
    assert!((-5.6..-2.0).contains(&x), "stands at {x}");
    assert_eq!(duty(&simulation, 0), [0, 0]);
    assert_eq!(simulation.network().unwrap().connected(), 0);
    let (mut signals, mut online) = (Vec::new(), Vec::new());
    for published in simulation.network().unwrap().take_record() {
        match Topic::parse(simulation.fleet(), &published.topic).unwrap() {
            Topic::Telemetry(_) => {
                let told = Telemetry::from_json(&published.payload).unwrap();
                signals.push(told.rssi_dbm.unwrap());
            }
            Topic::Status(_) => {
                online.push(StatusMessage::from_json(&published.payload).unwrap().online);
            }
            _ => {}
        }
    }
    assert_eq!(online, [true, false]);
    // Four metres away: 18.5 − 40 − 40.2 − 18.1.
    assert_eq!(signals.first(), Some(&-80));
    assert!((-90..=-87).contains(signals.last().unwrap()), "{signals:?}");
    assert!(signals.is_sorted_by(|a, b| a >= b), "{signals:?}");
}

#[test]
fn every_command_is_answered_across_partitions_of_a_scenario() {
    let text = r#"
        name = "two rooms"
        robots = 12
        [[radio.access_points]]
        x = -1.0
        y = 0.0
        [[radio.access_points]]
        x = 1.0
        y = 0.0
        channel = 6
        [[radio.partitions]]
        from_s = 6.0
        until_s = 20.0
        share = 0.6
        [[radio.partitions]]
        from_s = 30.0
        until_s = 44.0
        access_point = 0
        known = true
    "#;
    for seed in 0..3 {
        let mut simulation = simulation(text, seed);
        settle(&mut simulation);
        let turn = Action::Move {
            direction: Direction::Left,
            speed: 30,
            duration_ms: 600,
        };
        let mut given = Vec::new();
        // Before, on the way into, and within both partitions.
        for until_ms in [5_998, 7_000, 29_998, 31_000, 60_000] {
            given.push(simulation.submit_all(turn.clone()));
            simulation.run_until(crawler_hal::Instant::from_millis(until_ms));
        }
        let mut answers = Answers::new();
        collect(&simulation, &mut answers);
        let mut late = 0;
        for robot in 0..12 {
            let id = simulation.id(robot).unwrap().as_str().to_owned();
            for &seq in &given {
                let statuses = answers.get(&(id.clone(), seq)).cloned().unwrap_or_default();
                assert!(
                    statuses.iter().any(|status| status.is_final()),
                    "seed {seed}, {id}, command {seq}: {statuses:?}"
                );
                late += usize::from(!statuses.contains(&ResponseStatus::Completed));
            }
        }
        // Some were cut off: their commands came too late, or were overtaken.
        assert!(late > 0);
        assert_eq!(simulation.network().unwrap().connected(), 12);
    }
}

#[test]
fn what_the_radio_does_is_drawn_from_the_seed() {
    let run = |radio: &str, seed| {
        let text = format!("name = \"a\"\nrobots = 6\n{radio}");
        let mut simulation = simulation(&text, seed);
        simulation.run_for(Duration::from_secs(20));
        simulation.history_hash()
    };
    let weak = "[[radio.access_points]]\nx = 0.0\ny = 0.0\nattenuation_db = 62.0";
    assert_eq!(run(weak, 1), run(weak, 1));
    assert_ne!(run(weak, 1), run(weak, 2));
    assert_ne!(run(weak, 1), run("[radio]", 1));
    assert_ne!(run("[radio]", 1), run("", 1));
}

#[test]
fn a_scenario_whose_radio_cannot_be_is_refused_by_key() {
    for (text, key) in [
        ("[radio]\nwalls = 1", "walls"),
        (
            "[[radio.access_points]]\nx = nan\ny = 0.0",
            "access_points[0].x",
        ),
        ("[[radio.access_points]]\nx = 0.0", "missing field `y`"),
        (
            "[[radio.partitions]]\nfrom_s = 2.0\nuntil_s = 1.0",
            "partitions[0].until_s must be 2",
        ),
        ("[link]\nloss = 2.0", "loss must be 0 to 0.9"),
        ("[parameters.radio]\nexponent = 0.0", "radio.exponent"),
    ] {
        let error = Scenario::parse(&format!("name = \"a\"\n{text}")).unwrap_err();
        let error = error.to_string();
        assert!(error.contains(key), "{text}: {error}");
    }
}

#[test]
fn the_example_runs_and_its_robots_are_all_heard_in_the_end() {
    let mut simulation = simulation(include_str!("../scenarios/radio.toml"), 1);
    let air_of = |simulation: &Simulation| simulation.network().unwrap().connected();
    simulation.run_for(Duration::from_secs(14));
    assert_eq!(air_of(&simulation), 30);
    // Eleven seconds of silence are more than a robot or a broker bears.
    simulation.run_for(Duration::from_secs(10));
    let left = air_of(&simulation);
    assert!(
        (12..28).contains(&left),
        "{left} connected in the partition"
    );
    simulation.run_for(Duration::from_secs(46));
    assert_eq!(air_of(&simulation), 30);
    simulation.run_for(Duration::from_secs(50));
    assert_eq!(air_of(&simulation), 30);
}
