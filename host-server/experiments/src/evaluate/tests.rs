use clap::Parser;

use super::*;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    args: EvaluateArgs,
}

fn args(words: &[&str]) -> EvaluateArgs {
    let words = ["evaluate"].iter().chain(words);
    Line::try_parse_from(words).expect("options").args
}

#[test]
fn options_change_the_scenario() {
    let args = args(&[
        "--scenario",
        "simple-navigation",
        "--robots",
        "3",
        "--difficulty",
        "easy",
        "--randomisation",
        "mild",
        "--set",
        "duration_s=7",
    ]);
    let scenario = scenario(&args).expect("sound");
    assert_eq!((scenario.robots, scenario.duration_s), (3, 7.0));
    assert_eq!(scenario.arena.scatter.per_square_metre, 0.0);
    assert_eq!(scenario.randomisation.name(), "mild");
    assert_eq!(
        repeat(&args, args.randomisation, &["goals[0].x=1".to_owned()]),
        " --scenario simple-navigation --robots 3 --randomisation mild --difficulty easy \
         --set duration_s=7 --set 'goals[0].x=1'"
    );
}

#[test]
fn options_that_cannot_be_used_are_told_by_name() {
    for (words, told) in [
        (&["--set", "robots"][..], "not like key=value"),
        (&["--set", "colour=1"], "unknown field `colour`"),
        (&["--robots", "0"], "nothing to evaluate"),
        (&["--robots", "70000"], "--robots: robots must be at most"),
        (&["--difficulty", "odd"], "--difficulty: difficulty.level"),
    ] {
        let mut all = vec!["--scenario", "simple-navigation"];
        all.extend(words);
        let said = scenario(&args(&all)).expect_err("refused").to_string();
        assert!(said.contains(told), "{said}");
    }
    let wrong = ["evaluate", "--scenario", "empty", "--threshold", "luck>=1"];
    let said = Line::try_parse_from(wrong)
        .expect_err("refused")
        .to_string();
    assert!(said.contains("`luck` is none of"), "{said}");
}

#[test]
fn somebody_else_may_drive() {
    let driven = |scenario: &str, driver: &str| {
        let words = ["--scenario", scenario, "--driver", driver];
        super::scenario(&args(&words))
    };
    let program = driven("simple-navigation", "program").expect("sound");
    assert!(program.command.is_none() && program.goals[0].tell);
    let wanders = driven("simple-navigation", "wander").expect("sound");
    assert!(wanders.command.is_some() && !wanders.goals[0].tell);
    let ideal = driven("simple-navigation", "ideal").expect("sound");
    assert_eq!(ideal.goals, program.goals);
    let job = Job {
        scenario: &ideal,
        seed: 1,
    };
    let bound = bounds(&[job], &AtomicBool::new(false));
    assert!(bound[0].is_success(), "{:?}", bound[0].failures);
    assert_eq!(bounds(&[], &AtomicBool::new(true)), []);
    let said = driven("empty", "ideal").expect_err("refused").to_string();
    assert!(said.contains("no goals"), "{said}");
    let wrong = ["evaluate", "--scenario", "empty", "--driver", "luck"];
    let said = Line::try_parse_from(wrong)
        .expect_err("refused")
        .to_string();
    assert!(
        said.contains("`luck` is none of program, wander, ideal"),
        "{said}"
    );
}

#[test]
fn words_go_through_a_shell() {
    assert_eq!(quoted("a-b_c.toml"), "a-b_c.toml");
    assert_eq!(quoted("a b"), "'a b'");
    assert_eq!(quoted("it's"), "'it'\\''s'");
}
