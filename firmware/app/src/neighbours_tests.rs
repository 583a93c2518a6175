//! Which neighbours are kept, for how long, and what is dropped.

use std::vec::Vec;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{CellDigest, Neighbour as Told, RobotId, Says};
use proptest::prelude::*;

use super::{
    AHEAD, CELLS, FARTHEST, FRESH_FOR, MOST, Near, Neighbour, around, cell_at, centre, name_of,
};
use crate::testing::{TestRobot, robot};

const BOOTED_MS: u64 = 1_700_000_000_000;
const NOW: Instant = Instant::from_millis(10_000);
const NOW_MS: u64 = BOOTED_MS + 10_000;

fn told(id: &str, x: f32, y: f32, v: f32) -> Told {
    Told {
        id: RobotId::new(id).expect("legal"),
        x,
        y,
        theta: 0.0,
        v,
        w: 0.0,
        says: None,
    }
}

fn json(cell: (i16, i16), timestamp: u64, robots: &[Told]) -> Vec<u8> {
    let mut buffer = [0; 1_024];
    let digest = CellDigest {
        x: cell.0,
        y: cell.1,
        timestamp,
        count: robots.len() as u16,
        robots: robots.iter().cloned().collect(),
    };
    let len = digest.to_json(&mut buffer).expect("fits");
    buffer[..len].to_vec()
}

fn synchronised() -> TestRobot {
    let robot = robot("me");
    robot.time.observe(BOOTED_MS, Instant::BOOT);
    robot
}

fn near(robot: &TestRobot, at: Instant) -> Vec<Neighbour> {
    let mut near = Near::new();
    all_of(robot, &mut near, at)
}

/// As many looks as it takes to know of everybody.
fn all_of(robot: &TestRobot, near: &mut Near, at: Instant) -> Vec<Neighbour> {
    for _ in 0..MOST / Near::TAKEN {
        robot.control_handle().look_around(near, at);
    }
    let all = near.as_slice().iter();
    all.filter(|other| !other.is_nobody()).copied().collect()
}

#[test]
fn a_cell_tells_all_of_itself_and_nothing_of_others() {
    let robot = synchronised();
    let here = [told("me", 0.5, 0.5, 0.0), told("a", 1.0, 0.0, 0.0)];
    assert!(robot.observe_cell((0, 0), &json((0, 0), NOW_MS - 100, &here), NOW));
    let there = [told("b", 3.0, 0.0, 0.0)];
    assert!(robot.observe_cell((1, 0), &json((1, 0), NOW_MS - 90, &there), NOW));
    let xs = |at| -> Vec<i32> { near(&robot, at).iter().map(|n| n.at[0]).collect() };
    assert_eq!(xs(NOW), [1_000, 3_000], "without itself");
    // a has crossed the border: the newer word counts, whichever cell it is of.
    let crossed = [told("a", 2.1, 0.0, 0.0), told("b", 3.0, 0.0, 0.0)];
    assert!(robot.observe_cell((1, 0), &json((1, 0), NOW_MS, &crossed), NOW));
    assert_eq!(near(&robot, NOW).len(), 2);
    assert!(xs(NOW).contains(&2_100), "{:?}", xs(NOW));
    assert!(robot.observe_cell((1, 0), &json((1, 0), NOW_MS, &[]), NOW));
    assert!(xs(NOW).is_empty(), "everybody left");
}

#[test]
fn neighbours_move_on_and_are_forgotten() {
    let robot = synchronised();
    let moving = [told("a", 1.0, 0.0, 0.4)];
    assert!(robot.observe_cell((0, 0), &json((0, 0), NOW_MS, &moving), NOW));
    let later = near(&robot, NOW + Duration::from_millis(500));
    assert!((later[0].at[0] - 1_200).abs() <= 1, "{later:?}");
    assert_eq!(near(&robot, NOW + FRESH_FOR).len(), 1);
    let after = NOW + FRESH_FOR + Duration::from_millis(1);
    assert!(near(&robot, after).is_empty());
}

#[test]
fn a_look_goes_on_from_the_one_before_and_takes_in_what_is_new() {
    let robot = synchronised();
    let mut looks = Near::new();
    let mut at = |ms| {
        let now = NOW + Duration::from_millis(ms);
        let all = all_of(&robot, &mut looks, now);
        all.iter().map(|n| n.at).collect::<Vec<_>>()
    };
    assert!(at(0).is_empty());
    let message = |ms: u64, robots: &[Told]| json((0, 0), NOW_MS + ms, robots);
    let first = message(0, &[told_turning("a", 0.4, 0.5)]);
    assert!(robot.observe_cell((0, 0), &first, NOW));
    // However often it has been moved on, it is where it was told to be, plus the way since.
    for ms in (20..=1_500).step_by(20) {
        let [x, y] = at(ms)[0];
        let way = 400.0 * ms as f32 / 1_000.0;
        let off = (x as f32 - 1_000.0 - way).hypot(y as f32);
        assert!(off <= 2.0, "after {ms} ms {x} {y}");
    }
    assert!(at(1_520).is_empty());
    let other = message(1_540, &[told("b", 0.5, 0.0, 0.0)]);
    assert!(robot.observe_cell((0, 0), &other, NOW + Duration::from_millis(1_540)));
    assert_eq!(at(1_560), [[500, 0]]);
}

fn told_turning(id: &str, v: f32, w: f32) -> Told {
    Told {
        w,
        ..told(id, 1.0, 0.0, v)
    }
}

#[test]
fn robots_of_a_full_cell_are_kept_while_others_are_named() {
    let robot = synchronised();
    let named = |id: &str, says: &[i32], ms: u64| {
        let mut buffer = [0; 1_024];
        let digest = CellDigest {
            x: 0,
            y: 0,
            timestamp: NOW_MS + ms,
            count: 2,
            robots: core::iter::once(Told {
                says: Says::of_numbers(says),
                ..told(id, 1.0, 0.0, 0.0)
            })
            .collect(),
        };
        let len = digest.to_json(&mut buffer).expect("fits");
        let now = NOW + Duration::from_millis(ms);
        assert!(robot.observe_cell((0, 0), &buffer[..len], now));
        near(&robot, now)
    };
    assert_eq!(named("a", &[8, 1], 0).len(), 1);
    let both = named("b", &[], 500);
    assert_eq!(both.len(), 2);
    assert_eq!(both[0].says, Says::of_numbers(&[8, 1]), "word for word");
    assert_eq!(both[1].says, None);
    assert_eq!(both[1].who, name_of(&RobotId::new("b").expect("legal")));
    // As long as any neighbour, and then no more.
    assert_eq!(named("b", &[], 1_501).len(), 1);
}

#[test]
fn what_makes_no_sense_is_dropped() {
    let robot = synchronised();
    let one = [told("a", 1.0, 0.0, 0.0)];
    let judge = |cell, payload: &[u8]| robot.observe_cell(cell, payload, NOW);
    assert!(!judge((0, 0), b"{}"));
    assert!(!judge((1, 0), &json((0, 0), NOW_MS, &one)), "another cell");
    let stale = NOW_MS - FRESH_FOR.as_millis() - 1;
    assert!(!judge((0, 0), &json((0, 0), stale, &one)));
    let future = NOW_MS + AHEAD.as_millis() + 1;
    assert!(!judge((0, 0), &json((0, 0), future, &one)));
    assert!(judge((0, 0), &json((0, 0), NOW_MS, &one)));
    assert!(!judge((0, 0), &json((0, 0), NOW_MS - 1, &[])), "older");
    assert_eq!(near(&robot, NOW).len(), 1);
    let absurd = [
        told("b", 2_000.0, 0.0, 0.0),
        told("c", 0.0, 0.0, 80.0),
        told("d", 0.5, 0.0, 0.0),
    ];
    assert!(judge((0, 0), &json((0, 0), NOW_MS, &absurd)));
    assert_eq!(near(&robot, NOW).len(), 1, "d alone");
}

#[test]
fn the_nearest_are_kept() {
    let robot = synchronised();
    for column in 0..3_i16 {
        let far: Vec<Told> = (0..10)
            .map(|n| {
                let x = 5.9 - f32::from(column) * 2.0 - n as f32 * 0.1;
                told(&std::format!("r{column}-{n}"), x, 0.0, 0.0)
            })
            .collect();
        // From the far end to the near one.
        let cell = (2 - column, 0);
        assert!(robot.observe_cell(cell, &json(cell, NOW_MS, &far), NOW));
    }
    let near = near(&robot, NOW);
    assert_eq!(near.len(), MOST);
    let farthest = near.iter().fold(0, |most, n| most.max(n.at[0]));
    assert!(farthest < 4_000, "{farthest}");
    assert_eq!(near.iter().filter(|n| n.at[0] < 2_000).count(), 10);
}

#[test]
fn cells_have_a_border_and_a_middle() {
    assert_eq!(cell_at(-0.1, 2.0), Some((-1, 1)));
    assert_eq!(cell_at(f32::NAN, 0.0), None);
    assert_eq!(cell_at(FARTHEST + 1.0, 0.0), None);
    assert_eq!(centre(Some((0, 0)), 2.2, -0.2), Some((0, 0)));
    assert_eq!(centre(Some((0, 0)), 2.3, 0.5), Some((1, 0)));
    assert_eq!(centre(None, 2.2, 0.5), Some((1, 0)));
    assert_eq!(centre(Some((0, 0)), f32::INFINITY, 0.0), None);
    let cells = around((0, 0));
    assert_eq!(cells.len(), CELLS);
    assert_eq!(cells[0], (0, 0));
    assert_eq!(around((i16::MAX, 0)).len(), 6, "the edge of all cells");
    assert_ne!(
        name_of(&RobotId::new("a").expect("legal")),
        name_of(&RobotId::new("b").expect("legal"))
    );
}

proptest! {
    #[test]
    fn any_payload_is_taken_or_dropped(payload in prop::collection::vec(any::<u8>(), 0..300)) {
        let robot = synchronised();
        robot.observe_cell((0, 0), &payload, NOW);
        prop_assert!(near(&robot, NOW).len() <= MOST);
    }
}
