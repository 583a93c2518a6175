//! One world on several threads: the same history as on one.

use crate::common::{forward, scenario, wander};
use crawler_hal::{Duration, Instant};
use crawler_protocol::Action;
use crawler_sim::faults::{Fault, FaultError, Wheel};
use crawler_sim::net::lockstep::{Cut, LinkModel};
use crawler_sim::net::radio::{Partition, Radio};
use crawler_sim::run::parallel::{MAX_THREADS, Outcome, ParallelError, Plan, run};
use crawler_sim::run::{Simulation, SimulationError};
use crawler_sim::scenario::Scenario;
use proptest::prelude::*;

const TICK: Duration = Duration::from_millis(250);

fn plan(scenario: &Scenario, threads: usize, seconds: u64) -> Plan<'_> {
    Plan {
        scenario,
        seed: 3,
        network: true,
        threads,
        span: Duration::from_secs(seconds),
    }
}

/// Something that is done to a world from outside.
#[derive(Debug, Clone, Copy)]
enum Step {
    Forward(usize),
    StopAll,
    WanderAll,
    Reboot(usize),
    Cut(usize, Cut),
    Remove(usize),
    Spawn,
    Weaken(usize, f32),
    Drain(usize),
    Deafen(usize),
    Heal(usize),
    Garbage(usize),
}

fn carry_out(simulation: &mut Simulation, action: Step) {
    let mut inject = |robot, fault| match simulation.inject(robot, fault, None) {
        Ok(()) | Err(FaultError::NoRobot) => {}
        Err(error) => panic!("{error}"),
    };
    match action {
        Step::Forward(robot) => drop(simulation.submit(robot, forward(70, 3_000))),
        Step::StopAll => drop(simulation.submit_all(Action::Stop)),
        Step::WanderAll => drop(simulation.submit_all(wander())),
        Step::Reboot(robot) => drop(simulation.submit(robot, Action::Reboot)),
        Step::Cut(robot, cut) => simulation.cut(robot, cut),
        Step::Remove(robot) => simulation.remove(robot),
        Step::Spawn => {
            // A full arena is the same in every shard.
            let _ = simulation.spawn();
        }
        Step::Weaken(robot, strength) => {
            let wheel = Wheel::Left;
            inject(robot, Fault::MotorWeak { wheel, strength });
        }
        Step::Drain(robot) => inject(robot, Fault::BatteryAt { charge: 0.0 }),
        Step::Deafen(robot) => inject(robot, Fault::RangerDead),
        Step::Heal(robot) => simulation.heal(robot),
        Step::Garbage(robot) => simulation.submit_raw(robot, b"{\"command\":"),
    }
}

/// A script of actions, each at its tick.
fn script(actions: &[(u64, Step)]) -> impl Fn(&mut Simulation, Instant) -> Option<Instant> + Sync {
    move |simulation, now| {
        let tick = now.as_micros() / TICK.as_micros();
        for &(_, action) in actions.iter().filter(|(at, _)| *at == tick) {
            carry_out(simulation, action);
        }
        Some(now + TICK)
    }
}

fn same_on_all_threads(plan: &Plan<'_>, actions: &[(u64, Step)]) -> Outcome {
    let one = run(plan, script(actions)).unwrap();
    for threads in [2, 3, 4] {
        let plan = Plan { threads, ..*plan };
        let many = run(&plan, script(actions)).unwrap();
        let seconds = one.hashes.first_difference(&many.hashes);
        assert_eq!(seconds, None, "{threads} threads differ within a second");
        assert_eq!(many, one, "{threads} threads");
    }
    one
}

#[test]
fn motion_contacts_faults_commands_and_removals_are_the_same_on_any_number_of_threads() {
    let actions = [
        (24, Step::WanderAll),
        (26, Step::Weaken(0, 0.6)),
        (27, Step::Forward(2)),
        (28, Step::Cut(3, Cut::Silent)),
        (29, Step::Drain(4)),
        (30, Step::Remove(5)),
        (31, Step::Spawn),
        (32, Step::Reboot(6)),
        (33, Step::Deafen(7)),
        (34, Step::Garbage(1)),
        (36, Step::StopAll),
        (37, Step::Cut(3, Cut::None)),
        (38, Step::Heal(0)),
        (39, Step::WanderAll),
    ];
    let mut crowd = scenario("arena", 24);
    // Crowded, so that they meet.
    crowd.arena.area_per_robot = 0.4;
    crowd.arena.least_side = 2.5;
    crowd.arena.scatter.per_square_metre = 0.0;
    // And told nothing about where they are, or they would keep off each other.
    crowd.tracker.on = false;
    // They share one channel, and half of them lose it for a while.
    crowd.radio = Some(Radio {
        partitions: vec![Partition {
            from_s: 9.2,
            until_s: 11.7,
            region: None,
            access_point: None,
            share: 0.5,
            known: false,
        }],
        ..Radio::default()
    });
    let outcome = same_on_all_threads(&plan(&crowd, 1, 15), &actions);
    let contacts: u32 = outcome.robots.iter().map(|robot| robot.contacts).sum();
    assert!(contacts > 10, "{contacts} contacts");
    assert_eq!(outcome.robots.len(), 25, "one was added");
    assert!(!outcome.robots[5].present && !outcome.robots[4].powered);
    assert_eq!(outcome.boots[6], 2);
    assert_eq!(outcome.hashes.as_slice().len(), 15);
    assert!(outcome.statistics.received > 1_000);
}

#[test]
fn robots_without_a_network_are_the_same_on_any_number_of_threads() {
    let scenario = scenario("arena", 9);
    let plan = Plan {
        network: false,
        ..plan(&scenario, 1, 8)
    };
    let actions = [
        (8, Step::WanderAll),
        (9, Step::Forward(3)),
        (10, Step::Reboot(6)),
        (11, Step::Deafen(7)),
        (12, Step::Remove(2)),
        (13, Step::Weaken(0, 0.6)),
        (14, Step::Spawn),
        (15, Step::Garbage(1)),
        (16, Step::Cut(3, Cut::Silent)),
        (17, Step::Drain(4)),
        (18, Step::Heal(0)),
        (20, Step::StopAll),
    ];
    let outcome = same_on_all_threads(&plan, &actions);
    assert_eq!(outcome.statistics.received, 0);
    assert!(outcome.robots[0].pose != outcome.robots[1].pose);
}

#[test]
fn timed_faults_hostile_packets_and_a_radio_are_the_same_on_any_number_of_threads() {
    let mut text = String::from("name = \"trouble\"\nrobots = 10\n");
    text.push_str("[arena]\nwidth = 4.0\nheight = 4.0\n");
    text.push_str("[command]\ncommand = \"behave\"\nparameters = { behaviour = \"wander\" }\n");
    text.push_str("[[radio.access_points]]\nx = -2.0\ny = 0.0\nattenuation_db = 20.0\n");
    text.push_str("[[radio.access_points]]\nx = 2.0\ny = 0.0\nattenuation_db = 20.0\n");
    text.push_str("[[radio.partitions]]\nfrom_s = 8.0\nuntil_s = 10.0\nshare = 0.4\n");
    text.push_str("[parameters.radio]\nexponent = 3.3\nspike_share = 0.05\n");
    for (robot, fault) in [
        (0, "\"hostile-packets\"\nper_s = 20"),
        (1, "\"hostile-packets\"\nper_s = 3"),
        (2, "\"clock-step\"\nms = -90000"),
        (3, "\"link-loss\"\nhow = \"silent\""),
        (4, "\"line-noise\"\nflips = 0.02"),
        (5, "\"brown-out\""),
        (6, "\"ranger-noisy\"\nmm = 200"),
        (7, "\"motor-stuck-on\"\nwheel = \"right\""),
        (8, "\"flash-power-cut\"\nafter_bytes = 3"),
        (9, "\"battery-sag\"\nohm = 2.0"),
    ] {
        let at = 6.0 + 0.137 * f64::from(robot);
        let line = format!("[[faults]]\nat_s = {at}\nfor_s = 3.3\nrobots = [{robot}]\nfault = ");
        text.push_str(&line);
        text.push_str(fault);
        text.push('\n');
    }
    let scenario = Scenario::parse(&text).unwrap();
    // In the middle of it, robots that are attacked are told something that can be repeated.
    let actions = [
        (30, Step::Forward(0)),
        (31, Step::Forward(1)),
        (33, Step::Heal(4)),
    ];
    let outcome = same_on_all_threads(&plan(&scenario, 1, 13), &actions);
    let quiet = Scenario {
        faults: Vec::new(),
        ..scenario.clone()
    };
    let quiet = run(&plan(&quiet, 1, 13), script(&actions)).unwrap();
    assert!(
        outcome.history != quiet.history,
        "the faults make a difference"
    );
    assert!(outcome.boots[5] > 1 && quiet.boots[5] == 1);
}

#[test]
fn one_thread_is_an_ordinary_simulation_and_idle_threads_do_no_harm() {
    let scenario = scenario("empty", 2);
    let mut simulation = Simulation::lockstep(scenario.clone(), 3).unwrap();
    simulation.run_for(Duration::from_secs(7));
    for threads in [1, 4] {
        let outcome = run(&plan(&scenario, threads, 7), |_, _| None).unwrap();
        assert_eq!(outcome.history, simulation.history_hash());
        assert_eq!(&outcome.hashes, simulation.hashes());
        assert_eq!(outcome.polls, simulation.polls());
        let line = outcome.hashes.iter().last().unwrap().to_string();
        assert!(line.starts_with("second 7 hash "), "{line}");
    }
}

#[test]
fn a_panic_in_one_shard_ends_the_run() {
    let scenario = scenario("empty", 5);
    for threads in [1, 2, 4] {
        let wrong = threads - 1;
        let outcome = run(&plan(&scenario, threads, 600), |simulation, now| {
            let mine = simulation.robot(wrong).is_some();
            assert!(
                !mine || now < Instant::from_millis(1_000),
                "a wheel fell off"
            );
            Some(now + TICK)
        });
        match outcome {
            Err(ParallelError::Panicked(shard, text)) => {
                assert_eq!((shard, text.as_str()), (wrong, "a wheel fell off"));
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn what_cannot_run_is_refused() {
    let scenario = scenario("empty", 3);
    for threads in [0, MAX_THREADS + 1] {
        let outcome = run(&plan(&scenario, threads, 1), |_, _| None);
        assert!(matches!(outcome, Err(ParallelError::Threads(t)) if t == threads));
    }
    let mut full = scenario.clone().with_robots(200);
    (full.arena.width, full.arena.height) = (Some(1.0), Some(1.0));
    for threads in [1, 3] {
        let outcome = run(&plan(&full, threads, 1), |_, _| None);
        let no_room = |error: &SimulationError| matches!(error, SimulationError::NoRoom(_, 200));
        assert!(matches!(outcome, Err(ParallelError::SetUp(error)) if no_room(&error)));
    }
    // A script that does something else in each shard.
    let outcome = run(&plan(&scenario, 2, 2), |simulation, _| {
        if simulation.robot(0).is_some() {
            simulation.spawn().unwrap();
        }
        None
    });
    assert!(matches!(outcome, Err(ParallelError::Script)));
}

fn action() -> impl Strategy<Value = Step> {
    let robot = 0..7_usize;
    let cut = prop_oneof![
        Just(Cut::None),
        Just(Cut::Silent),
        Just(Cut::Radio),
        Just(Cut::Password)
    ];
    prop_oneof![
        3 => robot.clone().prop_map(Step::Forward),
        1 => Just(Step::StopAll),
        2 => Just(Step::WanderAll),
        1 => robot.clone().prop_map(Step::Reboot),
        2 => (robot.clone(), cut).prop_map(|(robot, cut)| Step::Cut(robot, cut)),
        1 => robot.clone().prop_map(Step::Remove),
        1 => Just(Step::Spawn),
        1 => (robot.clone(), 0.0..1.0_f32).prop_map(|(robot, share)| Step::Weaken(robot, share)),
        1 => robot.clone().prop_map(Step::Drain),
        1 => robot.clone().prop_map(Step::Deafen),
        1 => robot.clone().prop_map(Step::Heal),
        1 => robot.prop_map(Step::Garbage),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..crawler_properties::cases(8) })]

    #[test]
    fn whatever_is_done_to_a_world_its_history_is_the_same_on_three_threads(
        actions in proptest::collection::vec((0..36_u64, action()), 0..25),
        seed in any::<u64>(),
        loss in 0.0..0.3_f32,
    ) {
        let mut small = scenario("arena", 6);
        small.arena.area_per_robot = 0.6;
        small.arena.least_side = 1.8;
        small.arena.scatter.per_square_metre = 0.0;
        small.link = Some(LinkModel { loss, ..LinkModel::default() });
        let one = Plan { seed, ..plan(&small, 1, 9) };
        let three = Plan { threads: 3, ..one };
        let (one, three) = (run(&one, script(&actions)).unwrap(), run(&three, script(&actions)).unwrap());
        prop_assert_eq!(one.hashes.first_difference(&three.hashes), None);
        prop_assert_eq!(one, three);
    }
}
