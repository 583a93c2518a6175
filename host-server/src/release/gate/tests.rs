use std::path::Path;

use super::plan::{Expectation, Plan};
use super::*;

fn read(text: &str) -> Result<Plan, String> {
    let plan = Plan::read(text.as_bytes(), Path::new("/plans"));
    plan.map_err(|error| error.to_string())
}

fn expectation(robot: &str, output: &str, at_us: u64) -> Expectation {
    Expectation {
        robot: robot.to_owned(),
        output: output.to_owned(),
        at_us,
        why: "brakes earlier".to_owned(),
    }
}

#[test]
fn a_plan_says_what_to_run() {
    let plan = read(
        r#"
        [[evaluate]]
        scenario = "simple-navigation"
        seeds = 20
        robots = 3
        difficulty = "easy"
        randomisation = "mild"
        set = ["duration_s=7"]
        thresholds = ["success >= 0.9"]
        [[replay]]
        recording = "runs/corridor.mcap"
        expected = [{ robot = "rover-1", output = "duty", at_s = 12.345678, why = "brakes earlier" }]
        "#,
    );
    let plan = plan.unwrap_or_else(|what| panic!("{what}"));
    let [task] = &plan.tasks[..] else {
        panic!("one scenario")
    };
    assert_eq!((task.seed, task.seeds), (1, 20));
    assert_eq!((task.scenario.robots, task.scenario.duration_s), (3, 7.0));
    assert_eq!(task.scenario.randomisation.name(), "mild");
    assert_eq!(task.thresholds.len(), 1);
    let [recorded] = &plan.recordings[..] else {
        panic!("one recording")
    };
    assert_eq!(recorded.path, Path::new("/plans/runs/corridor.mcap"));
    assert_eq!(recorded.name, "corridor.mcap");
    assert_eq!(
        recorded.expected,
        [expectation("rover-1", "duty", 12_345_678)]
    );
}

#[test]
fn a_plan_that_cannot_be_carried_out_says_why() {
    let evaluate =
        "[[evaluate]]\nscenario = \"arena\"\nseeds = 2\nthresholds = [\"success >= 0.5\"]\n";
    let replay = |rest: &str| format!("{evaluate}[[replay]]\n{rest}");
    let expected = |rest: &str| replay(&format!("recording = \"a.mcap\"\nexpected = [{rest}]"));
    let one = r#"{ robot = "r", output = "duty", at_s = 1, why = "w" }"#;
    let cases = [
        (String::new(), "no scenario"),
        ("mood = 1".to_owned(), "unknown field `mood`"),
        (evaluate.replace("= 2", "= 0"), "seeds: 1 to"),
        (
            evaluate.replace("= 2", "= 2\nseed = 9223372036854775807"),
            "seed: the last one",
        ),
        (
            evaluate.replace("arena", "nowhere.toml"),
            "/plans/nowhere.toml",
        ),
        (evaluate.replace("success", "luck"), "`luck` is none of"),
        (evaluate.replace("0.5", "0.12345678"), "at most six places"),
        (
            evaluate.replace("= 2", "= 2\nrobots = 0"),
            "a world without robots",
        ),
        (
            evaluate.replace("= 2", "= 2\nrandomisation = \"odd\""),
            "none, mild or wild",
        ),
        (
            evaluate.replace("= 2", "= 2\nset = [\"colour=1\"]"),
            "unknown field `colour`",
        ),
        (
            evaluate.replace("\"success >= 0.5\"", ""),
            "nothing is asked",
        ),
        (evaluate.repeat(33), "`evaluate`: at most 32"),
        (replay("recording = \"/\""), "a name of at most"),
        (expected(&format!("{one}, {one}")), "a robot parts once"),
        (
            expected(&one.replace("duty", "panic")),
            "output: one of duty",
        ),
        (
            expected(&one.replace("= 1", "= -1")),
            "seconds of the recording",
        ),
        (expected(&one.replace("\"w\"", "\"\"")), "on one line"),
        (expected(&one.replace("\"w\"", "\"a\\nb\"")), "on one line"),
    ];
    for (text, told) in cases {
        let said = read(&text).map(drop).expect_err(told);
        assert!(said.contains(told), "{told}: {said}");
    }
    assert!(read(evaluate).is_ok() && read(&expected(one)).is_ok());
    assert!(Plan::read(&[0xFF], Path::new(".")).is_err());
}

#[test]
fn differences_are_expected_or_not_or_missing() {
    let expected = [
        expectation("r1", "duty", 7),
        expectation("r2", "state", 8),
        expectation("r3", "lamp", 9),
    ];
    let parted = [("r1", "duty", 7), ("r2", "state", 9), ("r4", PANIC, 0)];
    let (all, more) = compare(&parted, &expected);
    let findings: Vec<_> = all
        .iter()
        .map(|one| (one.robot.as_str(), one.at_us, one.finding))
        .collect();
    assert_eq!(
        findings,
        [
            ("r1", 7, Finding::Expected),
            ("r2", 8, Finding::Missing),
            ("r3", 9, Finding::Missing),
            ("r2", 9, Finding::Unexpected),
            ("r4", 0, Finding::Unexpected),
        ]
    );
    assert_eq!(more, 0);
    assert!(
        all.iter()
            .all(|one| one.why.is_some() != (one.finding == Finding::Unexpected))
    );
    // There is room for so many; the others are counted.
    let many = [("r9", "duty", 1); 40];
    let (all, more) = compare(&many, &expected);
    assert_eq!((all.len(), more), (MAX_ITEMS, 40 - 29));
}

#[test]
fn the_program_is_that_of_the_sources() {
    let program: Digest = PROGRAM.parse().expect("a hash");
    assert_ne!(program, Digest([0; 32]));
}
