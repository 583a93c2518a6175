use super::*;
use crate::world::Obstacle;

mod bodies;
mod timeline;
mod walls;

fn error(text: &str) -> String {
    Scenario::parse(text).unwrap_err().to_string()
}

#[test]
fn built_in_scenarios_are_sound_and_named_like_their_files() {
    for name in Scenario::names() {
        let scenario = Scenario::built_in(name).unwrap();
        assert_eq!(scenario.name, name);
        assert!(scenario.about.ends_with('.'), "{name}: {}", scenario.about);
        scenario.arena(1).unwrap();
    }
    let unknown = Scenario::built_in("labyrinth").unwrap_err().to_string();
    assert_eq!(
        unknown,
        "no scenario is called \"labyrinth\"; there are arena, corridor, empty, search, \
         simple-navigation, dynamic-environment, multi-robot-coordination, resilience, \
         long-duration, maze, rooms, u-trap, head-on, doorway, warehouse, long-corridor, find, crowd, \
         gather, disperse, spread, flock, formation, follow, patrol, consensus, allocate, cover, \
         line, wedge, circle"
    );
}

#[test]
fn a_preview_is_how_a_simulation_begins() {
    for (name, robots, seed) in [
        ("arena", 12, 3),
        ("multi-robot-coordination", 6, 1),
        ("dynamic-environment", 2, 9),
    ] {
        let scenario = Scenario::built_in(name).unwrap().with_robots(robots);
        let preview = scenario.preview(seed, 1_000).unwrap();
        let simulation = crate::run::Simulation::without_network(scenario.clone(), seed).unwrap();
        assert_eq!(preview.arena, simulation.world().arena(), "{name}");
        let poses = (0..simulation.robots()).map(|robot| simulation.pose(robot).unwrap());
        let poses: Vec<_> = poses.collect();
        assert_eq!(preview.poses.len(), robots as usize);
        for (seen, is) in preview.poses.iter().zip(&poses) {
            assert_eq!((seen.x, seen.y), (is.x, is.y), "{name}");
            assert!((seen.theta - is.theta).abs() < 1e-5, "{name}");
        }
        let few = scenario.preview(seed, 1).unwrap();
        assert_eq!(few.poses, preview.poses[..1]);
    }
    let crowd = Scenario::built_in("corridor").unwrap().with_robots(2_000);
    let error = crowd.preview(1, 1_000).unwrap_err().to_string();
    assert!(error.contains("no room for robot"), "{error}");
}

#[test]
fn a_scenario_says_what_it_is_in_a_line() {
    let about = |text: &str| format!("name = \"a\"\nabout = \"{text}\"");
    let longest = "\u{e9}".repeat(200);
    assert_eq!(Scenario::parse(&about(&longest)).unwrap().about, longest);
    for wrong in [&*"x".repeat(201), "two\\nlines", "\\u0007"] {
        let told = error(&about(wrong));
        assert!(told.contains("about must be one line"), "{told}");
    }
    // What says nothing is written without.
    let plain = Scenario::parse("name = \"a\"").unwrap();
    let plain = plain.to_whole_toml().unwrap();
    assert!(!plain.contains("about"), "{plain}");
}

#[test]
fn the_default_arena_grows_with_the_robots_and_is_drawn_from_the_seed() {
    let scenario = Scenario::built_in("arena").unwrap();
    let small = scenario.clone().with_robots(1).arena(1).unwrap();
    assert_eq!((small.width, small.height), (3.0, 3.0));
    let scenario = scenario.with_robots(200);
    let arena = scenario.arena(1).unwrap();
    assert_eq!((arena.width, arena.height), (20.0, 20.0));
    assert_eq!(arena.obstacles.len(), 40);
    assert_eq!(arena, scenario.arena(1).unwrap());
    assert_ne!(arena, scenario.arena(2).unwrap());
}

#[test]
fn scattered_obstacles_leave_room_between_them() {
    let scenario = Scenario::built_in("arena").unwrap().with_robots(500);
    let arena = scenario.arena(9).unwrap();
    for (index, obstacle) in arena.obstacles.iter().enumerate() {
        let (x, y, reach) = match *obstacle {
            Obstacle::Circle { x, y, r } => (x, y, r),
            Obstacle::Box { x, y, w, h, .. } => (x, y, (w * w + h * h).sqrt() * 0.5),
        };
        let mut others = arena.clone();
        others.obstacles.remove(index);
        assert!(others.clearance(x, y) >= reach + scenario.arena.scatter.clearance - 1e-3);
    }
}

#[test]
fn mistakes_are_told_by_name() {
    assert!(error("robots = 3").contains("missing field `name`"));
    assert!(error("name = \"a\"\nspeed = 3").contains("unknown field `speed`"));
    assert!(error("name = \"a\"\n[arena]\ncolour = 1").contains("unknown field `colour`"));
    assert!(error("name = \"a\"\n[spawn]\nclearance = \"x\"").contains("invalid type"));
    assert_eq!(
        error("name = \"\""),
        "line 1, column 1: name must have 1 to 64 bytes"
    );
    assert_eq!(
        error("name = \"a\"\nrobots = 70000"),
        "line 2, column 1: robots must be at most 65535, not 70000"
    );
    assert_eq!(
        error("name = \"a\"\n[arena]\nwidth = 3.0"),
        "line 3, column 1: arena.width is there without the other: give both arena.width and \
         arena.height"
    );
    assert_eq!(
        error("name = \"a\"\n[arena]\nwidth = 3.0\nheight = nan"),
        "line 4, column 1: arena.height must be 0.5 to 500, not NaN"
    );
    assert_eq!(
        error("name = \"a\"\n[arena.scatter]\nradius = [0.3, 0.1]"),
        "line 3, column 1: arena.scatter.radius must be 0.01 to 0.1, not 0.3"
    );
    assert_eq!(
        error("name = \"a\"\n[link]\nloss = 2.0"),
        "line 3, column 1: link.loss must be 0 to 0.9"
    );
    assert!(error("name = \"a\"\n[tracker]\nrate = 2.0").contains("unknown field `rate`"));
    assert_eq!(
        error("name = \"a\"\n[tracker]\nrate_hz = 0.0"),
        "line 3, column 1: tracker.rate_hz must be 0.1 to 50"
    );
    let dance = error("name = \"a\"\n[command]\ncommand = \"dance\"");
    let told = "line 3, column 1: command.command is refused: unknown_command; there are move, ";
    assert!(dance.starts_with(told), "{dance}");
    let dance = "[command]\ncommand = \"behave\"\nparameters = { behaviour = \"dance\" }";
    let dance = error(&format!("name = \"a\"\n{dance}"));
    let told = "line 4, column 16: command.parameters.behaviour is refused: unknown_behaviour; \
                there are manual, ";
    assert!(dance.starts_with(told), "{dance}");
    assert_eq!(
        error(
            "name = \"a\"\n[command]\ncommand = \"behave\"\nparameters = { behaviour = \"wander\", speed = 101 }"
        ),
        "line 4, column 38: command.parameters.speed is refused: out_of_range"
    );
    assert!(
        error("name = \"a\"\nrobots = 60000\n[arena]\narea_per_robot = 100.0")
            .contains("arena.area_per_robot")
    );
}

#[test]
fn robots_take_turns_at_the_two_wirings() {
    let mut scenario = Scenario::built_in("empty").unwrap();
    let pulse_among = |scenario: &Scenario, robots: usize| {
        let wired = (0..robots).map(|number| scenario.wiring(number));
        wired.filter(|&wiring| wiring == Wiring::Pulse).count()
    };
    assert_eq!(pulse_among(&scenario, 100), 0);
    scenario.parameters.ranger.wiring = Wiring::Pulse;
    assert_eq!(pulse_among(&scenario, 100), 100);
    for (share, robots, expected) in [
        (0.0, 100, 0),
        (1.0, 100, 100),
        (0.5, 7, 4),
        (0.25, 20, 5),
        // No number of 32 bits is 0.7 exactly.
        (0.7, 10, 7),
        (0.7, 1_000, 700),
    ] {
        scenario.spawn.pulse_share = Some(share);
        assert_eq!(pulse_among(&scenario, robots), expected, "{share}");
    }
    assert_eq!(
        error("name = \"a\"\n[spawn]\npulse_share = 1.5"),
        "line 3, column 1: spawn.pulse_share must be 0 to 1, not 1.5"
    );
    assert!(error("name = \"a\"\n[spawn]\npulse_share = nan").contains("not NaN"));
    assert!(error("name = \"a\"\n[spawn]\ncamera_share = -0.1").contains("spawn.camera_share"));
}

#[test]
fn too_little_room_is_said_instead_of_searched_for_ever() {
    let mut scenario = Scenario::built_in("arena").unwrap();
    scenario.arena.scatter.per_square_metre = 4.0;
    let told = scenario.arena(1).unwrap_err().to_string();
    assert!(told.starts_with("no room for obstacle"), "{told}");

    let crowded = Scenario::built_in("empty").unwrap().with_robots(2_000);
    let told = crate::run::Simulation::lockstep(crowded, 1).unwrap_err();
    assert!(told.to_string().starts_with("no room for robot"), "{told}");
}

#[test]
fn a_scenario_reads_as_it_was_written() {
    for name in Scenario::names() {
        let scenario = Scenario::built_in(name).unwrap();
        let text = serde_json::to_string(&scenario).unwrap();
        assert_eq!(serde_json::from_str::<Scenario>(&text).unwrap(), scenario);
        let text = scenario.to_toml().unwrap();
        assert_eq!(Scenario::parse(&text).unwrap(), scenario, "{text}");
    }
}
