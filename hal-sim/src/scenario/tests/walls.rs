//! Drawn walls.

use super::*;
use crate::scenario::Passable;

fn drawn(kind: &str, more: &str) -> Scenario {
    let text = format!(
        "name = \"a\"\n[arena]\nwidth = 8.0\nheight = 6.0\n[arena.generate]\nkind = \"{kind}\"\n{more}"
    );
    Scenario::parse(&text).unwrap()
}

#[test]
fn every_place_of_a_drawn_arena_can_be_reached() {
    for (kind, more) in [
        ("rooms", "loops = 0.0"),
        ("corridors", "side = 1.5"),
        ("maze", "side = 1.0\ndoor = 0.5"),
        (
            "rooms",
            "[arena.scatter]\nper_square_metre = 0.3\nclearance = 0.02",
        ),
    ] {
        let scenario = drawn(kind, more);
        for seed in 1..=8 {
            let arena = scenario.arena(seed).unwrap();
            assert!(arena.obstacles.len() > 2, "{kind} has no walls");
            assert!(Passable::new(&arena, 0.115).is_connected(), "{kind} {seed}");
            assert_eq!(arena, scenario.arena(seed).unwrap());
            assert_ne!(arena, scenario.arena(seed + 100).unwrap());
        }
    }
}

#[test]
fn scattered_obstacles_close_no_way_off() {
    let scenario = Scenario::parse(
        "name = \"a\"\n[arena]\nwidth = 4.0\nheight = 4.0\n[arena.scatter]\nper_square_metre = 0.8\nclearance = 0.02",
    )
    .unwrap();
    for seed in 1..=20 {
        let arena = scenario.arena(seed).unwrap();
        assert_eq!(arena.obstacles.len(), 12);
        assert!(Passable::new(&arena, 0.115).is_connected(), "{seed}");
    }
}

#[test]
fn doors_a_robot_does_not_fit_through_are_refused() {
    let text = "name = \"a\"\n[arena.generate]\nkind = \"maze\"\n";
    assert_eq!(
        error(&format!("{text}door = 0.2")),
        "line 4, column 1: arena.generate.door must be 0.27 to 50, not 0.2"
    );
    assert!(error(&format!("{text}side = 0.5")).contains("arena.generate.side"));
    assert!(error(&format!("{text}wall = nan")).contains("arena.generate.wall"));
    assert!(error("name = \"a\"\n[arena.generate]\nkind = \"cave\"").contains("unknown variant"));
}
