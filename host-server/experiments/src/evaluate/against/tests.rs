//! Comparisons end by themselves, and in the same way each time.

use clap::Parser;

use super::*;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    args: EvaluateArgs,
}

fn parse(words: &[&str]) -> Result<EvaluateArgs, String> {
    let head = [
        "evaluate",
        "--scenario",
        "spread",
        "--set",
        "success.settle_s=20",
        "--set",
        "duration_s=20",
    ];
    let parsed = Line::try_parse_from(head.iter().chain(words));
    parsed
        .map(|line| line.args)
        .map_err(|error| error.to_string())
}

fn args(words: &[&str]) -> EvaluateArgs {
    parse(words).expect("options")
}

fn compared(words: &[&str], threads: usize) -> Compared {
    let args = args(words);
    let first = super::super::scenario(&args).expect("sound");
    let second = args
        .against
        .clone()
        .expect("somebody")
        .scenario(&args)
        .expect("sound");
    let test = Test::new(args.error, args.seeds).expect("a test");
    let stop = AtomicBool::new(false);
    compare(
        args.seed,
        threads,
        &test,
        [&first, &second],
        &stop,
        &|_, _| {},
    )
}

const LEARNED: [&str; 6] = ["--policy", "spread", "--against", "wander", "--seeds", "60"];

#[test]
fn what_was_learned_is_better_than_wandering_on_any_threads() {
    let one = compared(&LEARNED, 1);
    assert_eq!(one.standing, Standing::Better(Side::First));
    let count = one.pairs.len();
    assert!((7..60).contains(&count), "{count}");
    for threads in [2, 5] {
        assert_eq!(compared(&LEARNED, threads), one);
    }
    // Seeds of a pair are the same, and follow each other.
    for (number, pair) in (1..).zip(&one.pairs) {
        assert_eq!((pair.first.seed, pair.second.seed), (number, number));
        assert_ne!(pair.first.history, pair.second.history);
    }
    // The other way round, the other one.
    let turned = ["--driver", "wander", "--against", "spread", "--seeds", "60"];
    let turned = compared(&turned, 2);
    assert_eq!(turned.standing, Standing::Better(Side::Second));
    let Pairs {
        both,
        first,
        second,
        neither,
    } = one.counts;
    let wanted = Pairs {
        both,
        first: second,
        second: first,
        neither,
    };
    assert_eq!(turned.counts, wanted);
}

#[test]
fn a_comparison_has_an_end_without_a_winner_too() {
    let few = [&LEARNED[..4], &["--seeds", "3"]].concat();
    let compared = compared(&few, 2);
    assert_eq!(
        (compared.standing, compared.pairs.len()),
        (Standing::Undecided, 3)
    );
    let names = [
        Other::Policy("spread".into()),
        Other::Driver(Driver::Wander),
    ];
    let test = Test::new(0.05, 3).expect("a test");
    let table = compared.table(&test, &names);
    for words in [
        "3 pairs of runs of one seed, of at most 3",
        "first    spread",
        "second   wander",
        "undecided",
    ] {
        assert!(table.contains(words), "{words}: {table}");
    }
    let args = args(&few);
    let scenario = super::super::scenario(&args).expect("sound");
    let told = compared.json(&test, &names, [&scenario, &scenario]);
    assert_eq!(
        (
            &told["standing"],
            &told["counts"]["pairs"],
            &told["first"]["driven_by"]
        ),
        (&json!("undecided"), &json!(3), &json!("spread"))
    );
    assert_eq!(told["pairs"].as_array().map(Vec::len), Some(3));
}

#[test]
fn one_that_is_broken_off_decides_nothing() {
    let args = args(&LEARNED);
    let scenario = super::super::scenario(&args).expect("sound");
    let test = Test::new(0.05, 60).expect("a test");
    let stop = AtomicBool::new(true);
    let compared = compare(1, 2, &test, [&scenario, &scenario], &stop, &|_, _| {});
    assert_eq!(
        (compared.standing, compared.counts),
        (Standing::Open, Pairs::default())
    );
    let code = run(
        &args,
        &scenario,
        args.against.as_ref().expect("somebody"),
        &stop,
    );
    assert_eq!(
        format!("{:?}", code.expect("it ran")),
        format!("{:?}", ExitCode::from(130))
    );
}

#[test]
fn what_cannot_be_compared_is_refused_by_name() {
    for (words, told) in [
        (&["--against", "ideal"][..], "nobody drives there"),
        (&["--against", ""], "is empty"),
        (&["--against", "spread", "--error", "0"], "--error"),
        (&["--against", "spread", "--error", "nan"], "--error"),
        (&["--error", "0.1"], "--against"),
        (
            &["--against", "spread", "--compare", "x"],
            "cannot be used with",
        ),
        (
            &["--against", "spread", "--csv", "x"],
            "cannot be used with",
        ),
        (
            &["--against", "spread", "--threshold", "success>=1"],
            "cannot be used with",
        ),
    ] {
        let said = parse(words).expect_err("refused");
        assert!(said.contains(told), "{said}");
    }
    for (words, told) in [
        (
            &["--against", "no/such/file"][..],
            "--against no/such/file: ",
        ),
        (
            &["--policy", "spread", "--against", "spread"],
            "drives already",
        ),
        (&["--against", "program"], "drives already"),
        (
            &["--driver", "wander", "--against", "wander"],
            "drives already",
        ),
        (
            &["--driver", "ideal", "--against", "wander"],
            "nobody drives",
        ),
    ] {
        let args = args(words);
        let driver = match args.driver {
            // Which has no scenario without goals.
            Driver::Ideal => Driver::Wander,
            other => other,
        };
        let policy = args.policy.as_deref();
        let first = scenario_driven(&args, driver, policy, "--policy").expect("sound");
        let other = args.against.as_ref().expect("somebody");
        let said = run(&args, &first, other, &AtomicBool::new(true))
            .expect_err("refused")
            .to_string();
        assert!(said.contains(told), "{said}");
    }
}
