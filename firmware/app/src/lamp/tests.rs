//! Which pattern for what.

use std::collections::HashSet;

use crawler_drivers::lamp::Pattern;
use crawler_hal::{Duration, Instant};
use crawler_protocol::RobotState;

use super::{lamp, pattern};
use crate::perception::{Charge, LinkHealth};
use crate::testing::ports::Line;
use crate::testing::{Executor, robot};

#[test]
fn every_state_has_a_pattern_of_its_own() {
    let patterns: HashSet<Pattern> = RobotState::ALL
        .iter()
        .map(|state| pattern(*state, Charge::Good, LinkHealth::Up, false))
        .collect();
    assert_eq!(patterns.len(), RobotState::ALL.len());
}

#[test]
fn what_needs_a_person_comes_first() {
    let moving = RobotState::Moving;
    let cases = [
        (
            pattern(moving, Charge::Low, LinkHealth::Lost, true),
            Pattern::Identify,
        ),
        (
            pattern(RobotState::Error, Charge::Low, LinkHealth::Lost, false),
            Pattern::Error,
        ),
        (
            pattern(RobotState::Error, Charge::Critical, LinkHealth::Up, false),
            Pattern::LowBattery,
        ),
        (
            pattern(moving, Charge::Low, LinkHealth::Lost, false),
            Pattern::LowBattery,
        ),
        (
            pattern(moving, Charge::Good, LinkHealth::Lost, false),
            Pattern::NoLink,
        ),
        (
            pattern(moving, Charge::Unknown, LinkHealth::Absent, false),
            Pattern::Moving,
        ),
    ];
    for (shown, wanted) in cases {
        assert_eq!(shown, wanted);
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
        .identify_until
        .lock(|cell| cell.set(Instant::from_millis(12_000)));
    robot.lamp_changed.signal(());
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
    robot.lamp_changed.signal(());
    executor.run_for(Duration::from_secs(1));
    assert!(executor.polls(0) > 2);
}
