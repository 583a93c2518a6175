//! Programs from the slots, run in lockstep: what is wrong with them shows, and a bad one is left behind.

use crawler_bundle::{Bundle, Defect, DefectKind};
use crawler_hal::{Duration, ResetCause};
use crawler_protocol::{Action, RobotState};

use crate::devices::install;
use crate::run::Simulation;
use crate::scenario::Scenario;

/// A robot that restarts into a new program when it is told to.
fn updated(bundle: &Bundle) -> Simulation {
    let scenario = Scenario::built_in("arena").expect("there").with_robots(1);
    let mut simulation = Simulation::lockstep(scenario, 7).expect("sound");
    simulation.run_for(Duration::from_secs(5));
    assert_eq!(firmware(&simulation), env!("CARGO_PKG_VERSION"));
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    install(&mut chip.borrow_mut(), bundle, 3_000, 0);
    simulation.submit(0, Action::Reboot);
    simulation
}

fn bundle(kind: DefectKind, value: u32) -> Bundle {
    Bundle {
        defects: vec![Defect::everywhere(kind, value)],
        ..Bundle::new("9.0.0", "new")
    }
}

fn firmware(simulation: &Simulation) -> &'static str {
    simulation.robot(0).expect("there").config().firmware
}

fn cause(simulation: &Simulation) -> ResetCause {
    simulation.robot(0).expect("there").boot().cause
}

/// Seconds until the robot runs another version again, at most `most`; and how often it started.
fn left_behind(simulation: &mut Simulation, most: u64) -> (u64, u32) {
    let before = simulation.boots(0);
    for second in 0..most {
        simulation.run_for(Duration::from_secs(1));
        if simulation.boots(0) > before + 1 && firmware(simulation) != "9.0.0" {
            return (second, simulation.boots(0) - before);
        }
    }
    panic!(
        "it still runs after {most} s: {} starts",
        simulation.boots(0) - before
    );
}

#[test]
fn a_program_without_defects_runs_as_what_it_says_it_is() {
    let mut simulation = updated(&Bundle::new("9.0.0", "new"));
    simulation.run_for(Duration::from_secs(20));
    assert_eq!((firmware(&simulation), simulation.boots(0)), ("9.0.0", 2));
    assert_eq!(cause(&simulation), ResetCause::Software);
    let robot = simulation.robot(0).expect("there");
    assert_eq!(robot.snapshot().state, RobotState::Idle);
}

#[test]
fn one_that_panics_or_hangs_is_tried_once_more() {
    let [panic, hang, miss] = [
        (DefectKind::Panic, 2_000),
        (DefectKind::Hang, 2_000),
        (DefectKind::MissControl, 200),
    ]
    .map(|(kind, value)| Defect::everywhere(kind, value));
    for defects in [vec![panic], vec![hang], vec![hang, miss]] {
        let panics = defects.contains(&panic);
        let mut simulation = updated(&Bundle {
            defects: defects.clone(),
            ..Bundle::new("9.0.0", "new")
        });
        let (_, starts) = left_behind(&mut simulation, 30);
        // Its first start, one more, and the program before.
        assert_eq!(starts, 3, "{defects:?}");
        simulation.run_for(Duration::from_secs(60));
        assert_eq!(simulation.boots(0), 4);
        // The program before hears of a restart, and of the panic.
        assert_eq!(cause(&simulation), ResetCause::Software);
        let robot = simulation.robot(0).expect("there");
        let text = robot.last_panic().map(|text| text.as_str().to_owned());
        let expected = "the defect panic=2000 of the bundle".to_owned();
        assert_eq!(text, panics.then_some(expected));
    }
}

#[test]
fn one_that_hangs_at_once_is_reset_all_the_same() {
    let mut simulation = updated(&bundle(DefectKind::Hang, 0));
    let (_, starts) = left_behind(&mut simulation, 30);
    assert_eq!(starts, 3);
}

#[test]
fn one_that_keeps_restarting_is_given_up_after_sixteen_starts() {
    let mut simulation = updated(&bundle(DefectKind::Restart, 1_000));
    let (_, starts) = left_behind(&mut simulation, 60);
    assert_eq!(starts, 17);
}

#[test]
fn one_that_misses_control_periods_goes_on() {
    let mut simulation = updated(&bundle(DefectKind::MissControl, 500));
    simulation.run_for(Duration::from_secs(30));
    assert_eq!((firmware(&simulation), simulation.boots(0)), ("9.0.0", 2));
    let seen = simulation.observe(0).expect("there");
    assert_eq!(seen.starvations, 0);
    let index = simulation.index(0).expect("there");
    let longest_us = simulation.world().longest_feed_gap_us(index);
    assert!(longest_us >= Some(60_000), "{longest_us:?}");
}

#[test]
fn one_without_a_ranger_reads_nothing_and_the_body_is_as_sound_as_before() {
    let mut simulation = updated(&bundle(DefectKind::RangerDead, 0));
    let reads = |simulation: &Simulation| {
        let robot = simulation.robot(0).expect("there");
        robot.snapshot().reading.sight.is_some()
    };
    simulation.run_for(Duration::from_secs(10));
    assert_eq!(
        (firmware(&simulation), reads(&simulation)),
        ("9.0.0", false)
    );
    let index = simulation.index(0).expect("there");
    for _ in 0..2 {
        simulation.world_mut().crash(index, "test");
        simulation.run_for(Duration::from_secs(5));
    }
    assert_ne!(firmware(&simulation), "9.0.0");
    assert!(reads(&simulation));
}

#[test]
fn one_that_never_links_is_not_heard_of() {
    let mut simulation = updated(&bundle(DefectKind::NeverLink, 0));
    simulation.run_for(Duration::from_secs(30));
    assert_eq!(firmware(&simulation), "9.0.0");
    let linked = |simulation: &Simulation| {
        let robot = simulation.robot(0).expect("there");
        robot
            .unix_ms(crawler_hal::Instant::from_millis(25_000))
            .is_some()
    };
    assert!(!linked(&simulation), "nobody has told it the time");
    let other = updated(&Bundle::new("9.0.0", "new"));
    let mut other = other;
    other.run_for(Duration::from_secs(30));
    assert!(linked(&other));
}

#[test]
fn parameters_of_a_bundle_are_above_those_that_are_stored() {
    let value = |simulation: &Simulation| {
        let robot = simulation.robot(0).expect("there");
        robot.with_parameters(|values| {
            values.number(crawler_app::parameters::Parameter::SafeDistance)
        })
    };
    let overrides = |name: &str, value| Bundle {
        parameters: vec![(name.to_owned(), value)],
        ..Bundle::new("9.0.0", "new")
    };
    let mut simulation = updated(&overrides("safe_distance_mm", 725.0));
    let before = value(&simulation);
    simulation.run_for(Duration::from_secs(10));
    assert_ne!(before, 725.0);
    assert_eq!(
        (firmware(&simulation), value(&simulation)),
        ("9.0.0", 725.0)
    );
    // What nobody knows cannot be overridden.
    for wrong in [
        overrides("warp_factor", 9.0),
        overrides("safe_distance_mm", -1.0),
    ] {
        let mut simulation = updated(&wrong);
        let (_, starts) = left_behind(&mut simulation, 30);
        assert_eq!(starts, 3);
        assert_eq!(value(&simulation), before);
    }
}
