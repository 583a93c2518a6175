use clap::Parser;
use proptest::prelude::*;
use serde_json::json;

use super::*;
use crate::evaluate::EvaluateArgs;

fn fields(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(fields) => fields,
        other => panic!("{other} is no object"),
    }
}

fn wrong(value: Value) -> Vec<(String, String)> {
    let errors = read(fields(value)).expect_err("refused");
    let field = |pointer: &str| pointer.split('/').nth(1).unwrap_or_default().to_owned();
    errors
        .into_iter()
        .map(|error| (field(&error.pointer), error.detail))
        .collect()
}

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    args: EvaluateArgs,
}

/// What a shell makes of a line that [`quoted`] has written.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word) = (Vec::new(), String::new());
    let (mut inside, mut escaped) = (false, false);
    for c in line.chars() {
        match c {
            c if escaped => {
                word.push(c);
                escaped = false;
            }
            '\'' => inside = !inside,
            '\\' if !inside => escaped = true,
            ' ' if !inside => words.push(std::mem::take(&mut word)),
            c => word.push(c),
        }
    }
    words.push(word);
    words
}

#[test]
fn a_recipe_is_taken_as_it_stands() {
    let wanted = read(fields(json!({
        "name": " first try ", "scenario": "simple-navigation", "seeds": 40, "first_seed": 5,
        "difficulty": "easy", "randomisation": "mild", "robots": 3,
        "set": ["duration_s = 7"], "thresholds": ["success >= 0.9"], "start": false,
    })))
    .expect("sound");
    assert_eq!((wanted.name.as_str(), wanted.start), ("first try", false));
    assert_eq!(
        (wanted.recipe.in_each, wanted.scenario.duration_s),
        (3, 7.0)
    );
    assert_eq!(
        wanted.recipe.command(),
        "terracrawler evaluate --scenario simple-navigation --robots 3 --randomisation mild \
         --difficulty easy --set 'duration_s = 7' --seeds 40 --seed 5 --threshold 'success >= 0.9'"
    );
    let plain = read(fields(
        json!({ "name": "x", "scenario": "empty", "seeds": 1 }),
    ));
    let plain = plain.expect("sound");
    assert!(plain.start && plain.build().is_ok());
    assert_eq!((plain.recipe.first_seed, plain.recipe.robots), (1, None));
    assert!(plain.recipe.in_each > 0);
    let text = serde_json::to_string(&plain.recipe).expect("JSON");
    let again: Recipe = serde_json::from_str(&text).expect("read");
    assert_eq!(again, plain.recipe);
    assert_eq!(again.scenario().expect("known").0, plain.scenario);
}

#[test]
fn everything_that_is_wrong_is_named_at_once() {
    let all = wrong(json!({
        "name": "", "scenario": "arena", "robots": 10_001, "seeds": 0, "first_seed": -1,
        "difficulty": 5, "randomisation": "odd", "set": ["robots"], "thresholds": ["luck >= 1"],
        "start": "yes", "colour": "red",
    }));
    let names: Vec<_> = all.iter().map(|(field, _)| field.as_str()).collect();
    for field in [
        "name",
        "robots",
        "seeds",
        "first_seed",
        "difficulty",
        "randomisation",
        "set",
        "thresholds",
        "start",
        "colour",
    ] {
        assert!(names.contains(&field), "{field}: {all:?}");
    }
    let nothing = wrong(json!({}));
    let names: Vec<_> = nothing.iter().map(|(field, _)| field.as_str()).collect();
    assert_eq!(names, ["name", "scenario", "seeds"]);
}

#[test]
fn what_only_the_scenario_knows_is_named_too() {
    for (key, value, field, told) in [
        ("scenario", json!("nowhere"), "scenario", "is none of arena"),
        // A file of the server's is nobody's business.
        ("scenario", json!("/etc/passwd"), "scenario", "is none of"),
        ("difficulty", json!("odd"), "difficulty", "is none of"),
        ("set", json!(["colour=1"]), "set", "unknown field `colour`"),
        ("set", json!(["robots"]), "set", "not like key=value"),
        ("set", json!(["robots=0"]), "robots", "must be 1 to 10000"),
        ("set", json!(["robots=10001"]), "robots", "must be 1 to"),
        ("set", json!(["duration_s=-1"]), "set", "duration_s"),
        ("set", json!("robots=1"), "set", "list of texts"),
        ("set", json!(["a\nb=1"]), "set", "control characters"),
        ("set", json!(vec!["robots=1"; 33]), "set", "more than 32"),
        (
            "thresholds",
            json!(["success"]),
            "thresholds",
            "is not like",
        ),
        ("name", json!("a\u{7}"), "name", "control"),
        ("name", json!("x".repeat(65)), "name", "1 to 64"),
        ("seeds", json!(1.5), "seeds", "whole number"),
        (
            "first_seed",
            json!(1_u64 << 53),
            "first_seed",
            "must be 0 to",
        ),
    ] {
        let mut body = json!({ "name": "x", "scenario": "simple-navigation", "seeds": 1 });
        body[key] = value.clone();
        let all = wrong(body);
        let fits = |(name, message): &(String, String)| name == field && message.contains(told);
        assert!(all.iter().any(fits), "{key} = {value}: {all:?}");
    }
}

#[test]
fn entries_and_odd_names_are_pointed_at() {
    let errors = read(fields(json!({
        "name": "x", "scenario": "empty", "seeds": 1, "set": ["robots=2", "colour=1"],
        "thresholds": ["success >= 0.5", "luck >= 1"], "a/b~c": 1,
    })));
    let errors = errors.expect_err("refused");
    let mut pointers: Vec<_> = errors.iter().map(|error| error.pointer.as_str()).collect();
    pointers.sort_unstable();
    assert_eq!(pointers, ["/a~1b~0c", "/set/1", "/thresholds/1"]);
}

#[test]
fn a_world_that_cannot_be_built_is_refused() {
    let crowded = json!({
        "name": "x", "scenario": "empty", "seeds": 1, "robots": 2_000,
        "set": ["arena.width=2.0", "arena.height=2.0"],
    });
    match read(fields(crowded)) {
        Ok(wanted) => {
            let errors = wanted.build().expect_err("there is no room");
            assert_eq!(errors[0].pointer, "/scenario");
        }
        Err(errors) => assert!(!errors.is_empty()),
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    /// Whatever is accepted is the same on the command line.
    #[test]
    fn the_command_line_comes_to_the_same(
        scenario in proptest::sample::select(vec!["empty", "arena", "simple-navigation", "corridor"]),
        robots in proptest::option::of(1_u32..50),
        difficulty in proptest::option::of(prop_oneof![
            Just("easy".to_owned()), (0.0_f32..=1.0).prop_map(|number| number.to_string()),
        ]),
        randomisation in proptest::option::of(proptest::sample::select(vec!["none", "mild", "wild"])),
        duration in proptest::option::of(1.0_f32..500.0),
        odd in proptest::option::of("[ -~]{0,20}"),
        seeds in 1_u32..=100_000,
        first_seed in 0..(1_u64 << 52),
        threshold in proptest::option::of(0.0_f64..1.0),
    ) {
        let set: Vec<String> = duration
            .map(|seconds| format!("duration_s = {seconds:?}"))
            .into_iter()
            .chain(odd.map(|name| format!("name='{name}'")))
            .collect();
        let thresholds: Vec<String> =
            threshold.map(|value| format!("reached >= {value}")).into_iter().collect();
        let body = json!({
            "name": "x", "scenario": scenario, "robots": robots, "difficulty": difficulty,
            "randomisation": randomisation, "set": set, "thresholds": thresholds,
            "seeds": seeds, "first_seed": first_seed,
        });
        let Ok(wanted) = read(fields(body)) else { return Ok(()) };
        let line = wanted.recipe.command();
        let args = Line::try_parse_from(words(&line).into_iter().skip(1))
            .map_err(|error| TestCaseError::fail(format!("{line}: {error}")))?
            .args;
        prop_assert_eq!((args.seeds, args.seed), (u64::from(seeds), first_seed));
        prop_assert_eq!(args.threshold.len(), thresholds.len());
        let there = crate::evaluate::scenario(&args);
        let there = there.map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(there, wanted.scenario);
    }

    /// Whatever comes, it is taken or refused with a reason for each field.
    #[test]
    fn any_body_is_answered(
        keys in proptest::collection::vec("name|scenario|seeds|robots|set|thresholds|difficulty|[a-z]{1,5}", 0..6),
        texts in proptest::collection::vec(".{0,80}", 6),
        number in any::<i64>(),
    ) {
        let body: Map<String, Value> = keys
            .iter()
            .zip(&texts)
            .enumerate()
            .map(|(index, (key, text))| {
                let value = match index % 3 {
                    0 => json!(text),
                    1 => json!(number),
                    _ => json!([text]),
                };
                (key.clone(), value)
            })
            .collect();
        if let Err(errors) = read(body) {
            prop_assert!(!errors.is_empty());
            prop_assert!(errors.iter().all(|error| !error.detail.is_empty()));
        }
    }
}
