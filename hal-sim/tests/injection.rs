//! Every fault that can be injected leads to the state that `docs/faults.md` states for it, and
//! is over when its time is, or when it is healed.

use crate::common::{Answers, collect, duty, forward, lockstep, settle};
use crawler_app::trouble::LinkTrouble;
use crawler_hal::{Duration, ResetCause};
use crawler_protocol::{Action, Direction, FaultName, Reason, ResponseStatus, RobotState};
use crawler_sim::faults::{Fault, FaultError, LinkCut, Wheel};
use crawler_sim::run::Simulation;

const SECOND: Duration = Duration::from_secs(1);
const PAGE: &str = include_str!("../../docs/faults.md");

fn ready(seed: u64) -> Simulation {
    let mut simulation = lockstep("empty", 1, seed);
    settle(&mut simulation);
    simulation
}

fn state(simulation: &Simulation) -> RobotState {
    simulation.robot(0).unwrap().snapshot().state
}

fn inject(simulation: &mut Simulation, fault: Fault, lasting: Duration) {
    simulation.inject(0, fault, Some(lasting)).unwrap();
}

fn left(speed: u8, duration_ms: u32) -> Action {
    Action::Move {
        direction: Direction::Left,
        speed,
        duration_ms,
    }
}

#[test]
fn the_page_lists_every_fault_and_a_test_of_it() {
    let mut lines = PAGE
        .lines()
        .skip_while(|line| !line.starts_with("| injected |"));
    lines.next().expect("the table");
    let rows: Vec<Vec<&str>> = lines
        .skip(1)
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    let listed: Vec<&str> = rows
        .iter()
        .map(|row| row[0].split('`').nth(1).expect("a name"))
        .collect();
    let all: Vec<&str> = FaultName::ALL.iter().map(|fault| fault.name()).collect();
    assert_eq!(listed, all);
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for row in rows {
        let (file, test) = row[4].split_once(' ').expect("a file and a test");
        let text = std::fs::read_to_string(root.join(file.trim_matches('`'))).expect(file);
        assert!(text.contains(&format!("fn {test}(")), "{file}: {test}");
    }
}

#[test]
fn a_dead_ranger_comes_back_by_itself_when_its_time_is_over() {
    for fault in [Fault::RangerDead, Fault::LineStuck] {
        let mut simulation = ready(1);
        inject(&mut simulation, fault, SECOND * 3);
        simulation.run_for(SECOND * 2);
        assert_eq!(state(&simulation), RobotState::Error, "{fault:?}");
        simulation.run_for(SECOND * 3);
        assert_eq!(state(&simulation), RobotState::Idle, "{fault:?}");
    }
}

#[test]
fn a_fault_takes_the_place_of_the_one_before_time_and_all() {
    let mut simulation = ready(1);
    inject(&mut simulation, Fault::RangerDead, SECOND);
    simulation.inject(0, Fault::RangerDead, None).unwrap();
    simulation.run_for(SECOND * 5);
    assert_eq!(state(&simulation), RobotState::Error);
    simulation.heal(0);
    simulation.run_for(SECOND * 3);
    assert_eq!(state(&simulation), RobotState::Idle);
}

#[test]
fn a_stuck_ranger_is_found_out_by_driving() {
    let mut simulation = ready(2);
    simulation
        .inject(0, Fault::RangerStuck { mm: 2_000 }, None)
        .unwrap();
    simulation.submit(0, left(40, 8_000));
    simulation.run_for(SECOND * 6);
    assert_eq!(state(&simulation), RobotState::Error);
    assert_eq!(duty(&simulation, 0), [0, 0]);
    simulation.heal(0);
    simulation.run_for(SECOND * 3);
    assert_eq!(state(&simulation), RobotState::Idle);
}

/// Spread of the readings of a standing robot, in millimetres.
fn spread(simulation: &mut Simulation) -> u16 {
    let mut seen = Vec::new();
    for _ in 0..100 {
        simulation.run_for(Duration::from_millis(80));
        let now = simulation.now();
        let reading = simulation.robot(0).unwrap().snapshot().reading;
        seen.extend(reading.range_mm(now));
    }
    let (least, most) = (seen.iter().min().unwrap(), seen.iter().max().unwrap());
    most - least
}

#[test]
fn a_noisy_ranger_is_off_until_it_is_healed() {
    let mut simulation = ready(3);
    let sound = spread(&mut simulation);
    simulation
        .inject(0, Fault::RangerNoisy { mm: 300 }, None)
        .unwrap();
    let noisy = spread(&mut simulation);
    assert!(noisy > 5 * sound.max(20), "{noisy} mm after {sound} mm");
    simulation.heal(0);
    simulation.run_for(SECOND);
    assert!(spread(&mut simulation) <= 2 * sound.max(20));
}

#[test]
fn a_noisy_line_is_a_state_or_a_reading_and_never_a_motion() {
    let mut simulation = ready(3);
    inject(&mut simulation, Fault::LineNoise { flips: 0.5 }, SECOND * 3);
    for _ in 0..300 {
        simulation.run_for(Duration::from_millis(10));
        assert_eq!(duty(&simulation, 0), [0, 0]);
    }
    simulation.run_for(SECOND * 3);
    assert_eq!(state(&simulation), RobotState::Idle);
}

#[test]
fn a_weak_or_dead_motor_pulls_to_its_side() {
    let wheel = Wheel::Left;
    for (fault, least) in [
        (
            Fault::MotorWeak {
                wheel,
                strength: 0.5,
            },
            0.3,
        ),
        (Fault::MotorDead { wheel }, 1.0),
    ] {
        let mut simulation = ready(4);
        inject(&mut simulation, fault, SECOND * 2);
        let before = simulation.observe(0).unwrap().pose.theta;
        simulation.submit(0, forward(60, 1_500));
        simulation.run_for(SECOND);
        let turned = simulation.observe(0).unwrap().pose.theta - before;
        let turned = turned.rem_euclid(core::f32::consts::TAU);
        assert!(turned > least, "{fault:?}: {turned}");
        simulation.run_for(SECOND * 2);
        simulation.submit(0, forward(60, 1_000));
        simulation.run_for(Duration::from_millis(700));
        let turn = simulation.observe(0).unwrap().turn;
        assert!(turn.abs() < 0.5, "{fault:?}: {turn}");
    }
}

#[test]
fn a_shorted_bridge_moves_a_robot_that_says_it_stands() {
    let mut simulation = ready(5);
    let wheel = Wheel::Right;
    inject(&mut simulation, Fault::MotorStuckOn { wheel }, SECOND);
    simulation.run_for(Duration::from_millis(800));
    assert_eq!(duty(&simulation, 0), [0, 0], "nobody asked for it");
    assert!(simulation.observe(0).unwrap().turn > 0.5);
    simulation.run_for(SECOND * 2);
    assert_eq!(simulation.observe(0).unwrap().turn, 0.0);
}

#[test]
fn a_lost_link_comes_back_when_its_time_is_over() {
    for (how, trouble) in [
        (LinkCut::Radio, LinkTrouble::NoNetwork),
        (LinkCut::Password, LinkTrouble::Password),
        (LinkCut::NoAddress, LinkTrouble::NoAddress),
        (LinkCut::Silent, LinkTrouble::NoBroker),
    ] {
        let mut simulation = ready(6);
        inject(&mut simulation, Fault::LinkLoss { how }, SECOND * 40);
        simulation.run_for(SECOND * 35);
        let told = simulation.robot(0).unwrap().link_trouble();
        assert_eq!(told, Some(trouble), "{how}");
        simulation.run_for(SECOND * 60);
        assert_eq!(simulation.robot(0).unwrap().link_trouble(), None, "{how}");
        let mut answers = Answers::new();
        let seq = simulation.submit(0, Action::Stop);
        simulation.run_for(SECOND);
        collect(&simulation, &mut answers);
        let completed = vec![ResponseStatus::Completed];
        assert_eq!(answers[&("sim-0001".to_owned(), seq)], completed);
    }
}

#[test]
fn a_dip_of_the_supply_resets_the_robot_and_it_knows_why() {
    let mut simulation = ready(7);
    simulation.submit(0, forward(60, 5_000));
    simulation.run_for(SECOND);
    inject(&mut simulation, Fault::BrownOut, Duration::from_millis(500));
    simulation.run_for(Duration::from_millis(100));
    let seen = simulation.observe(0).unwrap();
    assert!(!seen.powered);
    assert_eq!(seen.duty, [0, 0]);
    simulation.run_for(SECOND * 8);
    assert!(simulation.observe(0).unwrap().powered);
    assert_eq!(simulation.boots(0), 2);
    let robot = simulation.robot(0).unwrap();
    assert_eq!(robot.boot().cause, ResetCause::BrownOut);
    assert_eq!(state(&simulation), RobotState::Idle);
    assert_eq!(duty(&simulation, 0), [0, 0], "the move is forgotten");
}

#[test]
fn a_worn_or_empty_battery_is_told_and_stops_the_robot() {
    let mut simulation = ready(8);
    inject(&mut simulation, Fault::BatterySag { ohm: 20.0 }, SECOND * 4);
    simulation.submit(0, forward(100, 3_000));
    simulation.run_for(SECOND * 10);
    assert!(simulation.boots(0) > 1, "it browned out");
    assert_eq!(state(&simulation), RobotState::Idle);
    let empty = Fault::BatteryAt { charge: 0.0 };
    inject(&mut simulation, empty, SECOND);
    simulation.run_for(SECOND * 10);
    let dead = !simulation.observe(0).unwrap().powered;
    assert!(dead || state(&simulation) == RobotState::Error);
}

#[test]
fn a_power_cut_in_a_write_to_flash_costs_a_reset_and_no_parameters() {
    let mut simulation = ready(9);
    let cut = Fault::FlashPowerCut { after_bytes: 5 };
    simulation.inject(0, cut, None).unwrap();
    let mut values = crawler_protocol::ParameterValues::new();
    let name = heapless::String::try_from("safe_distance_mm").unwrap();
    let value = crawler_protocol::ParameterValue::Number(700.0);
    values.push((name, value)).unwrap();
    simulation.submit(0, Action::Set(values));
    simulation.run_for(SECOND * 10);
    assert_eq!(simulation.boots(0), 2);
    assert_eq!(state(&simulation), RobotState::Idle);
    assert_eq!(simulation.observe(0).unwrap().flash_violations, 0);
}

#[test]
fn a_clock_that_jumped_refuses_motion_obeys_stop_and_is_set_right() {
    const HOUR_MS: i64 = 3_600_000;
    for (ms, expected) in [
        (HOUR_MS, (ResponseStatus::Expired, None)),
        (
            -HOUR_MS,
            (ResponseStatus::Rejected, Some(Reason::OutOfRange)),
        ),
    ] {
        let mut simulation = ready(10);
        simulation.run_for(SECOND * 12);
        inject(&mut simulation, Fault::ClockStep { ms }, SECOND);
        let off = |simulation: &Simulation| {
            let robot = simulation.robot(0).unwrap();
            robot.unix_ms(simulation.now()).unwrap() as i64 - simulation.unix_ms() as i64
        };
        assert!((off(&simulation) - ms).abs() < 100, "{ms}");
        let turn = simulation.submit(0, left(40, 500));
        let stop = simulation.submit(0, Action::Stop);
        simulation.run_for(SECOND);
        let mut told = std::collections::BTreeMap::new();
        for published in simulation.network().unwrap().take_record() {
            if let Ok(response) = crawler_protocol::Response::from_json(&published.payload) {
                told.insert(response.seq, (response.status, response.reason));
            }
        }
        assert_eq!(told[&turn], expected);
        assert_eq!(told[&stop], (ResponseStatus::Completed, None));
        assert_eq!(duty(&simulation, 0), [0, 0]);
        simulation.run_for(SECOND * 25);
        assert!(off(&simulation).abs() < 100, "{ms}: {}", off(&simulation));
    }
}

#[test]
fn hostile_packets_move_nobody_and_cost_no_command() {
    let mut simulation = ready(11);
    let attack = Fault::HostilePackets { per_s: 50 };
    inject(&mut simulation, attack, SECOND * 30);
    let sent = simulation.submit(0, left(40, 300));
    simulation.run_for(SECOND * 3);
    let mut given = vec![sent];
    for _ in 0..20 {
        given.push(simulation.submit(0, Action::Stop));
        for _ in 0..100 {
            simulation.run_for(Duration::from_millis(10));
            assert_eq!(duty(&simulation, 0), [0, 0]);
        }
    }
    simulation.run_for(SECOND * 60);
    assert_eq!(simulation.boots(0), 1);
    assert_eq!(state(&simulation), RobotState::Idle);
    let mut answers = Answers::new();
    collect(&simulation, &mut answers);
    for seq in given {
        let last = answers[&("sim-0001".to_owned(), seq)].last();
        assert_eq!(last, Some(&ResponseStatus::Completed), "{seq}");
    }
}

#[test]
fn what_cannot_be_broken_is_refused_and_nothing_changes() {
    let mut simulation = ready(12);
    let hash = simulation.history_hash();
    let dead = Fault::RangerDead;
    assert_eq!(simulation.inject(7, dead, None), Err(FaultError::NoRobot));
    let wide = Fault::RangerNoisy { mm: 2_000 };
    let refused = simulation.inject(0, wide, None);
    assert!(matches!(refused, Err(FaultError::Range(_))));
    assert_eq!(simulation.history_hash(), hash);
    simulation.remove(0);
    assert_eq!(simulation.inject(0, dead, None), Err(FaultError::NoRobot));
    let mut alone = Simulation::without_network(crate::common::scenario("empty", 1), 1).unwrap();
    let how = LinkCut::Radio;
    let lost = alone.inject(0, Fault::LinkLoss { how }, None);
    assert_eq!(lost, Err(FaultError::NoNetwork));
}
