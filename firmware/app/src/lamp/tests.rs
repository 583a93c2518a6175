//! Which pattern for what.

use std::collections::HashSet;

use crawler_drivers::lamp::Pattern;
use crawler_hal::{Duration, Instant};
use crawler_protocol::RobotState;

use super::{View, lamp, pattern};
use crate::perception::{Charge, LinkHealth};
use crate::state::Fault;
use crate::testing::ports::Line;
use crate::testing::{Executor, robot};
use crate::trouble::LinkTrouble;

const SOUND: View = View {
    state: RobotState::Moving,
    fault: None,
    charge: Charge::Good,
    link: LinkHealth::Up,
    trouble: None,
    identify: false,
};

#[test]
fn every_state_has_a_pattern_of_its_own() {
    let patterns: HashSet<Pattern> = RobotState::ALL
        .iter()
        .map(|&state| pattern(&View { state, ..SOUND }))
        .collect();
    assert_eq!(patterns.len(), RobotState::ALL.len());
}

#[test]
fn every_fault_and_every_trouble_has_a_pattern_of_its_own() {
    let standing = [
        Fault::EmergencyStop,
        Fault::Motor,
        Fault::Battery,
        Fault::Ranger,
    ]
    .map(|fault| {
        pattern(&View {
            state: RobotState::Error,
            fault: Some(fault),
            ..SOUND
        })
    });
    let cut_off = LinkTrouble::ALL.map(|trouble| {
        pattern(&View {
            link: LinkHealth::Absent,
            trouble: Some(trouble),
            ..SOUND
        })
    });
    let all: HashSet<Pattern> = standing.into_iter().chain(cut_off).collect();
    assert_eq!(all.len(), standing.len() + cut_off.len());
}

#[test]
fn what_needs_a_person_comes_first() {
    let lost = View {
        link: LinkHealth::Lost,
        ..SOUND
    };
    let low = View {
        charge: Charge::Low,
        ..lost
    };
    let error = View {
        state: RobotState::Error,
        ..low
    };
    let trouble = Some(LinkTrouble::NoAddress);
    let identify = true;
    let cases = [
        (View { identify, ..error }, Pattern::Identify),
        (error, Pattern::Error),
        (
            View {
                charge: Charge::Critical,
                fault: Some(Fault::EmergencyStop),
                ..error
            },
            Pattern::LowBattery,
        ),
        (View { trouble, ..low }, Pattern::LowBattery),
        (lost, Pattern::NoLink),
        (View { trouble, ..lost }, Pattern::NoAddress),
        // An old trouble of a session that is up is none.
        (View { trouble, ..SOUND }, Pattern::Moving),
        (
            View {
                link: LinkHealth::Absent,
                charge: Charge::Unknown,
                ..SOUND
            },
            Pattern::Moving,
        ),
    ];
    for (view, wanted) in cases {
        assert_eq!(pattern(&view), wanted, "{view:?}");
    }
}

#[test]
fn it_sleeps_between_edges_and_wakes_for_identify() {
    let robot = robot("lamp");
    let pin = Line::default();
    let mut executor = Executor::default();
    executor.spawn(lamp(&robot, pin.clone(), executor.clock.clone()));
    executor.run_for(Duration::from_secs(10));
    // INITIALIZING: half a second lit, half a second dark.
    assert!(
        (20..=22).contains(&executor.polls(0)),
        "{}",
        executor.polls(0)
    );

    robot
        .control_handle()
        .identify(Instant::from_millis(12_000));
    robot.control_handle().wake_lamp();
    let before = executor.polls(0);
    executor.run_for(Duration::from_secs(2));
    let edges = executor.polls(0) - before;
    assert!(edges > 25, "blinks fast: {edges}");
    let before = executor.polls(0);
    executor.run_for(Duration::from_secs(2));
    assert!(executor.polls(0) - before <= 6, "and then no more");
}

#[test]
fn a_pin_that_refuses_costs_the_lamp_only() {
    let robot = robot("lamp");
    let pin = Line::default();
    pin.refuses.set(true);
    let mut executor = Executor::default();
    executor.spawn(lamp(&robot, pin.clone(), executor.clock.clone()));
    executor.run_for(Duration::from_secs(10));
    assert_eq!(
        executor.polls(0),
        1,
        "nothing to try until the pattern changes"
    );
    pin.refuses.set(false);
    robot.control_handle().wake_lamp();
    executor.run_for(Duration::from_secs(1));
    assert!(executor.polls(0) > 2);
}
