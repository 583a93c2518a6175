//! Commands, faults, goals, spawn rules, difficulty, success.

use proptest::prelude::*;

use super::*;
use crate::faults::Fault;

fn with(text: &str) -> Scenario {
    Scenario::parse(&format!("name = \"a\"\nrobots = 4\n{text}")).unwrap()
}

fn wrong(text: &str) -> String {
    error(&format!("name = \"a\"\nrobots = 4\n{text}"))
}

#[test]
fn a_timeline_is_read_as_it_is_written() {
    let scenario = with(
        "[[faults]]\nat_s = 2\nfor_s = 0.5\nrobots = [1, 3]\nfault = \"ranger-stuck\"\nmm = 300\n\
         [[commands]]\nat_s = 7.5\nevery_s = 10.0\nrobots = 0.5\ncommand = \"stop\"\n",
    );
    let fault = &scenario.faults[0];
    assert_eq!(fault.fault, Fault::RangerStuck { mm: 300 });
    assert_eq!((fault.at_s, fault.for_s), (2.0, Some(0.5)));
    let broken: Vec<_> = (0..4).map(|robot| fault.robots.has(robot)).collect();
    assert_eq!(broken, [false, true, false, true]);
    let told = (0..4).filter(|&robot| scenario.commands[0].robots.has(robot));
    assert_eq!(told.count(), 2);
}

#[test]
fn mistakes_in_a_timeline_are_told_with_their_place() {
    let fault = "[[faults]]\nat_s = 1.0\nfault = \"ranger-dead\"\n";
    for (text, told) in [
        (
            format!("{fault}robots = [4]"),
            "line 6, column 1: faults[0].robots names robot 4, and the last of 4 is 3",
        ),
        (
            format!("{fault}robots = \"some\""),
            "not a scenario: invalid value: string \"some\"",
        ),
        (format!("{fault}speed = 1"), "unknown field `speed`"),
        (
            format!("{fault}[[faults]]\nat_s = -1.0\nfault = \"ranger-dead\""),
            "line 7, column 1: faults[1].at_s must be 0 to 2419200, not -1",
        ),
        (
            "[[faults]]\nat_s = 1.0".to_owned(),
            "line 3, column 1: not a scenario: missing field `fault`",
        ),
        (
            "[[faults]]\nat_s = 1.0\nfault = \"line-noise\"\nflips = 2.0".to_owned(),
            "line 3, column 1: not a scenario: invalid value: a number out of range",
        ),
        (
            "[[commands]]\nat_s = 1.0\ncommand = \"dance\"".to_owned(),
            "line 5, column 1: commands[0].command is refused: unknown_command",
        ),
        (
            "[[commands]]\nat_s = 1.0\nevery_s = 0.0\ncommand = \"stop\"".to_owned(),
            "line 5, column 1: commands[0].every_s must be 0.1 to 2419200, not 0",
        ),
        (
            "duration_s = 90000.0\n[[commands]]\nat_s = 1.0\nevery_s = 0.1\ncommand = \"stop\""
                .to_owned(),
            "line 6, column 1: commands[0].every_s makes it happen more than 100000 times",
        ),
        (
            "[[goals]]\nx = 1.0".to_owned(),
            "line 3, column 1: goals[0] must have x and y, or places, or draw",
        ),
        (
            "[[goals]]\nx = 1.0\ny = 9.0".to_owned(),
            "line 3, column 1: goals[0] must lie in the arena, not at 1, 9",
        ),
        (
            "[[goals]]\nplaces = [[0, 0], [nan, 1]]".to_owned(),
            "line 4, column 19: goals[0].places[1] must lie in the arena",
        ),
        (
            "[success]\nreach = 1.5".to_owned(),
            "line 4, column 1: success.reach must be 0 to 1, not 1.5",
        ),
        (
            "thresholds = [\"luck >= 1\"]".to_owned(),
            "`luck` is none of success, reached",
        ),
        (
            "thresholds = [\"success > 1\"]".to_owned(),
            "is not like `success >= 0.9`",
        ),
    ] {
        let said = wrong(&text);
        assert!(said.contains(told), "{text}\n{said}");
    }
}

#[test]
fn robots_start_where_they_are_put() {
    let scenario = with(
        "[spawn]\nposes = [{ x = -1.0, y = 0.0, theta = 1.0 }]\n\
         line = { from = [0.0, -1.0], to = [0.0, 1.0] }\n",
    );
    let simulation = crate::run::Simulation::lockstep(scenario, 3).unwrap();
    let places: Vec<_> = (0..4)
        .map(|robot| simulation.observe(robot).unwrap().pose)
        .map(|pose| (pose.x, pose.y))
        .collect();
    assert_eq!(places, [(-1.0, 0.0), (0.0, -1.0), (0.0, 0.0), (0.0, 1.0)]);

    let zones = "[spawn]\nzones = [{ x = -1.0, y = 0.0, w = 0.8, h = 0.8 }, { x = 1.0, y = 0.0, w = 0.8, h = 0.8 }]";
    let simulation = crate::run::Simulation::lockstep(with(zones), 3).unwrap();
    for robot in 0..4 {
        let pose = simulation.observe(robot).unwrap().pose;
        let middle = if robot % 2 == 0 { -1.0 } else { 1.0 };
        assert!((pose.x - middle).abs() <= 0.4 && pose.y.abs() <= 0.4);
    }
}

#[test]
fn robots_that_would_stand_in_each_other_are_refused() {
    let pose = |x: f32, y: f32| format!("{{ x = {x}, y = {y} }}");
    let poses = |list: &[String]| format!("[spawn]\nposes = [{}]", list.join(", "));
    let said = wrong(&poses(&[pose(0.0, 0.0), pose(1.0, 1.0), pose(0.1, 0.1)]));
    assert_eq!(
        said,
        "line 4, column 46: spawn.poses[2] overlaps spawn.poses[0]: robots 0 and 2"
    );
    let said = wrong(&poses(&[pose(9.0, 0.0)]));
    assert!(said.contains("puts a robot at 9, 0, into a wall"), "{said}");
    assert!(wrong("[spawn]\nposes = [{ x = inf, y = 0.0 }]").contains("must be finite"));
    let line = "[spawn]\nline = { from = [0.0, 0.0], to = [0.4, 0.0] }";
    assert!(wrong(line).contains("line 4, column 1: spawn.line overlaps spawn.line"));
    let zone = |size: &str| format!("[spawn]\nzones = [{{ x = 0, y = 0, w = {size}, h = 1 }}]");
    assert!(wrong(&zone("0")).contains("spawn.zones[0] must have a positive width"));
    assert!(wrong(&zone("99")).contains("lie in the arena"));
    assert!(wrong(&zone("nan")).contains("lie in the arena"));
}

#[test]
fn difficulty_lies_between_the_ends_of_its_keys() {
    let text = "[link]\nloss = 0.5\n[difficulty]\nlevel = \"hard\"\nlevels = { hard = 0.75 }\n\
                [difficulty.keys]\n\"link.loss\" = [0.0, 0.4]\nrobots = [2, 8]\n";
    let scenario = with(text);
    assert!((scenario.link.unwrap().loss - 0.3).abs() < 1e-6);
    assert_eq!(scenario.robots, 7);
    let easy = scenario.clone().with_difficulty("0").unwrap();
    assert_eq!((easy.link.unwrap().loss, easy.robots), (0.0, 2));
    assert_eq!(scenario.clone().with_difficulty("hard").unwrap(), {
        let mut same = scenario.clone();
        let difficulty = same.difficulty.as_mut().unwrap();
        difficulty.level = None;
        difficulty.value = Some(0.75);
        same
    });
    // What is set by hand stays, also in a file.
    let set = scenario.with_value("link.loss", "0.1").unwrap();
    let read = Scenario::parse(&set.to_toml().unwrap()).unwrap();
    assert_eq!((read.link.unwrap().loss, read.robots), (0.1, 7));

    let said = wrong(&text.replace("\"hard\"", "\"odd\""));
    assert_eq!(
        said,
        "line 6, column 1: difficulty.level \"odd\" is none of hard"
    );
    let said = wrong(&text.replace("link.loss", "link.colour"));
    assert!(
        said.contains("difficulty.keys cannot set link.colour"),
        "{said}"
    );
    let said = wrong(&text.replace("[0.0, 0.4]", "[0.0, \"x\"]"));
    assert!(
        said.contains("needs two finite numbers for link.loss"),
        "{said}"
    );
    let plain = with("").with_difficulty("0.5").unwrap_err().to_string();
    assert!(plain.contains("difficulty is not stated"), "{plain}");
}

#[test]
fn any_key_can_be_set() {
    let scenario = with("[[goals]]\nx = 1.0\ny = 0.0");
    let set = |key: &str, value: &str| scenario.with_value(key, value);
    assert_eq!(set("arena.least_side", "4").unwrap().arena.least_side, 4.0);
    assert_eq!(set("goals[0].x", "-1.0").unwrap().goals[0].x, Some(-1.0));
    assert_eq!(
        set("randomisation", "wild").unwrap().randomisation,
        Profile::Wild
    );
    assert_eq!(
        set("success.collisions", "3").unwrap().success.collisions,
        Some(3.0)
    );
    for (key, value, told) in [
        ("arena.colour", "1", "unknown field `colour`"),
        ("goals[7].x", "1", "goals[7].x is no key"),
        ("robots", "\"x\"", "invalid type"),
        ("robots", "99999", "must be at most 65535"),
        ("", "1", "is no key of a scenario"),
    ] {
        let said = set(key, value).unwrap_err().to_string();
        assert!(said.contains(told), "{key}: {said}");
    }
}

#[test]
fn thresholds_compare_means() {
    let at_least: Threshold = "success >= 0.9".parse().unwrap();
    assert_eq!(at_least.metric, Metric::Success);
    assert!(at_least.is_met(Some(0.9)) && !at_least.is_met(Some(0.89)) && !at_least.is_met(None));
    let at_most: Threshold = " collisions<=2 ".parse().unwrap();
    assert!(at_most.is_met(Some(2.0)) && !at_most.is_met(Some(2.1)));
    assert_eq!(at_most.to_string(), "collisions <= 2");
    assert!("success >= nan".parse::<Threshold>().is_err());
}

#[test]
fn quotas_count_whole_robots() {
    assert!(Quota::All.is_met(4, 4) && !Quota::All.is_met(3, 4));
    assert!(Quota::Any.is_met(1, 4) && !Quota::Any.is_met(0, 4));
    assert!(Quota::Share(0.9).is_met(9, 10) && !Quota::Share(0.9).is_met(8, 10));
    assert!(Quota::All.is_met(0, 0) && Quota::Any.is_met(0, 0));
}

fn file() -> impl Strategy<Value = String> {
    let names: Vec<&'static str> = BUILT_IN.iter().map(|&(_, text)| text).collect();
    prop::sample::select(names).prop_map(str::to_owned)
}

proptest! {
    #![proptest_config(crawler_properties::cases(400))]

    /// Whatever a file has become, it is a scenario or is refused with a reason.
    #[test]
    fn no_file_does_harm(
        text in file(),
        cuts in prop::collection::vec((any::<prop::sample::Index>(), 0_usize..12), 0..4),
        pastes in prop::collection::vec(
            (
                any::<prop::sample::Index>(),
                prop::sample::select(vec![
                    "nan", "inf", "-1", "0", "1e39", "99999999999", "\"\"", "[", "]", "{", "}", "=",
                    "\n", "[[goals]]\n", "[arena]\n", "true", "-0.0", ".", "\u{e4}", "\u{0}",
                ]),
            ),
            0..4,
        ),
    ) {
        let mut text: Vec<char> = text.chars().collect();
        for (at, length) in cuts {
            let at = at.index(text.len());
            let end = (at + length).min(text.len());
            text.drain(at..end);
            if text.is_empty() {
                text.push('\n');
            }
        }
        for (at, paste) in pastes {
            let at = at.index(text.len());
            text.splice(at..at, paste.chars());
        }
        let text: String = text.into_iter().collect();
        match Scenario::parse(&text) {
            Ok(scenario) => {
                let written = scenario.to_toml().unwrap();
                prop_assert_eq!(Scenario::parse(&written).unwrap(), scenario);
            }
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    /// The same where every number of a file is replaced, one at a time.
    #[test]
    fn no_number_does_harm(
        text in file(),
        which in any::<prop::sample::Index>(),
        number in prop_oneof![
            any::<f64>().prop_map(|number| format!("{number:?}")),
            any::<i64>().prop_map(|number| number.to_string()),
        ],
    ) {
        let digits = |c: char| c.is_ascii_digit() || c == '.';
        let places: Vec<_> = text
            .match_indices(|c: char| c.is_ascii_digit())
            .map(|(at, _)| at)
            .collect();
        let at = places[which.index(places.len())];
        let end = at + text[at..].find(|c| !digits(c)).unwrap_or(text.len() - at);
        let changed = format!("{}{number}{}", &text[..at], &text[end..]);
        if let Ok(scenario) = Scenario::parse(&changed) {
            prop_assert!(scenario.validate().is_ok());
        }
    }
}
