//! `terracrawler evaluate`, as a person calls it.

use std::path::PathBuf;
use std::process::{Command, Output};

const STRAIGHT: &str = "
name = \"straight\"
duration_s = 25.0
[arena]
width = 4.0
height = 2.0
[spawn]
poses = [{ x = -0.6, y = 0.0 }]
[[goals]]
x = 0.6
y = 0.0
";

/// A folder of one test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("evaluate-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn file(name: &str, text: &str) -> PathBuf {
    let path = folder(name).join("scenario.toml");
    std::fs::write(&path, text).expect("a file");
    path
}

fn terracrawler<'a>(words: impl IntoIterator<Item = &'a str>) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terracrawler"))
        .args(words)
        .output()
        .expect("it runs")
}

fn evaluate(scenario: &str, options: &[&str]) -> Output {
    let words = ["evaluate", "--scenario", scenario];
    terracrawler(words.iter().chain(options).copied())
}

/// Does what a text says: replays the first run that it names, which fails as it did.
fn replays(text: &str, failure: &str) {
    let told = text
        .lines()
        .find_map(|line| line.trim().strip_prefix("terracrawler "))
        .unwrap_or_else(|| panic!("it does not say how to see it again: {text}"));
    let words = told.split_whitespace().map(|word| word.trim_matches('\''));
    let output = terracrawler(words);
    let said = said(&output.stdout) + &said(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}: {said}");
    assert!(said.contains(&format!("failed, {failure}")), "{said}");
}

fn said(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn thresholds_decide_and_files_are_written() {
    let path = file("thresholds", STRAIGHT);
    let (csv, json) = (path.with_extension("csv"), path.with_extension("json"));
    let scenario = path.to_str().expect("UTF-8");
    let files = [
        "--csv",
        csv.to_str().expect("UTF-8"),
        "--json",
        json.to_str().expect("UTF-8"),
    ];
    let mut options = vec!["--seeds", "3", "--threshold", "success>=1"];
    options.extend(files);
    let output = evaluate(scenario, &options);
    let text = said(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(
        text.contains("threshold success >= 1: met (1.0000)"),
        "{text}"
    );
    let table = std::fs::read_to_string(&csv).expect("a table");
    let (head, rows): (Vec<_>, Vec<_>) = table.lines().partition(|line| line.starts_with('#'));
    assert_eq!(rows.len(), 4);
    let head = head.join("\n");
    for part in [
        crawler_experiments::BUILD,
        "--seeds 3 --seed 1",
        "randomisation none",
        "#   duration_s = 25.0",
    ] {
        assert!(head.contains(part), "{head}");
    }
    let value = std::fs::read_to_string(&json).expect("a file");
    let value: serde_json::Value = serde_json::from_str(&value).expect("JSON");
    assert_eq!(value["metrics"]["success"]["mean"], 1.0);
    let text = value["provenance"]["text"].as_str().expect("the scenario");
    let again = crawler_sim::scenario::Scenario::parse(text).expect("sound");
    assert_eq!((again.name.as_str(), again.duration_s), ("straight", 25.0));

    let impossible = [
        "--seeds",
        "2",
        "--seed",
        "7",
        "--set",
        "success.distance_m=50",
    ];
    let mut options = impossible.to_vec();
    options.extend(["--threshold", "success>=0.5"]);
    let output = evaluate(scenario, &options);
    let text = said(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("NOT MET (0.0000)"), "{text}");
    assert!(text.contains("seed 8: distance_m: "), "{text}");
    let again =
        format!("terracrawler replay --scenario {scenario} --set success.distance_m=50 --seed 8");
    assert!(text.contains(&again), "{text}");
    replays(&text, "distance_m: ");
    let mild = [
        &impossible[..],
        &["--randomisation", "mild", "--robots", "1"],
    ]
    .concat();
    replays(&said(&evaluate(scenario, &mild).stdout), "distance_m: ");
}

#[test]
fn a_sweep_has_a_line_for_each_point() {
    let path = file("sweep", STRAIGHT);
    let scenario = path.to_str().expect("UTF-8");
    let sweep = [
        "--seeds",
        "1",
        "--sweep",
        "goals[0].x=0:0.6:2",
        "--sweep",
        "robots=1",
    ];
    let output = evaluate(scenario, &sweep);
    let text = said(&output.stdout);
    assert_eq!(
        output.status.code(),
        Some(0),
        "{text}{}",
        said(&output.stderr)
    );
    assert_eq!(text.lines().count(), 3, "{text}");
    assert!(text.starts_with("goals[0].x     robots"), "{text}");

    let drawn = ["--monte-carlo", "4", "--randomisation", "mild"];
    let text = said(&evaluate(scenario, &drawn).stdout);
    assert!(
        text.contains("parameters drawn from their mild ranges"),
        "{text}"
    );

    // A point that misses a threshold is named, with a run that shows it.
    let far = ["--seeds", "2", "--sweep", "success.distance_m=0.5,50"];
    let far = [&far[..], &["--threshold", "success>=1"]].concat();
    let output = evaluate(scenario, &far);
    let text = said(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    let missed = "success.distance_m=50: NOT MET success >= 1 (0.0000)";
    assert!(text.contains(missed), "{text}");
    assert!(!text.contains("success.distance_m=0.5:"), "{text}");
    replays(&text, "distance_m: ");
}

#[test]
fn runs_are_held_against_earlier_ones_of_the_same_seeds() {
    let path = file("compare", STRAIGHT);
    let scenario = path.to_str().expect("UTF-8");
    let json = path.with_extension("json");
    let json = json.to_str().expect("UTF-8");
    let output = evaluate(scenario, &["--seeds", "4", "--json", json]);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output.stderr));

    let text = said(&evaluate(scenario, &["--seeds", "5", "--compare", json]).stdout);
    let told = format!(
        "compared with {json}: 4 pairs of runs of one seed, 4 of them with the same history"
    );
    assert!(
        text.contains(&told) && !text.contains("differing"),
        "{text}"
    );

    // What is nearer is reached sooner, every time.
    let near = ["--seeds", "4", "--set", "goals[0].x=0.2", "--compare", json];
    let text = said(&evaluate(scenario, &near).stdout);
    assert!(
        text.contains("0 of them with the same history")
            && text.contains("differing in: the scenario\n")
            && text
                .lines()
                .any(|line| line.starts_with("  time_to_goal_s") && line.ends_with("  better")),
        "{text}"
    );

    for (content, told) in [
        ("", "not a file of `evaluate --json`"),
        (
            "{\"scenario\": \"x\", \"trials\": []}",
            "there is no run in it",
        ),
    ] {
        std::fs::write(json, content).expect("a file");
        let output = evaluate(scenario, &["--compare", json]);
        assert_eq!(output.status.code(), Some(2));
        let text = said(&output.stderr);
        assert!(text.contains("--compare ") && text.contains(told), "{text}");
    }
}

#[test]
fn a_replay_goes_to_the_failure_or_to_the_end() {
    let path = file("replay", STRAIGHT);
    let scenario = path.to_str().expect("UTF-8");
    let recording = path.with_extension("mcap");
    let fine = [
        "replay",
        "--scenario",
        scenario,
        "--seed",
        "3",
        "--record",
        recording.to_str().expect("UTF-8"),
    ];
    let output = terracrawler(fine);
    let text = said(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("\nsucceeded\n"), "{text}");
    let bytes = std::fs::read(&recording).expect("a recording");
    let command = format!("replay --scenario {scenario} --seed 3");
    for part in [command.as_str(), crawler_experiments::BUILD] {
        let part = part.as_bytes();
        assert!(bytes.windows(part.len()).any(|window| window == part));
    }

    // What is lost at a moment ends it there.
    let late = [&fine[..5], &["--set", "success.within_s=3"]].concat();
    let late = [&late[..], &["--set", "success.reach=1.0"]].concat();
    let output = terracrawler(late);
    let text = said(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains(": 3.05") && text.contains("failed, reach: 0 of 1 robots"),
        "{text}"
    );

    let output = terracrawler(["replay"]);
    assert_eq!(output.status.code(), Some(2));
    let text = said(&output.stderr);
    assert!(
        text.contains("nothing is said of what to replay")
            && text.contains("terracrawler replay --scenario NAME --seed N"),
        "{text}"
    );
}

#[test]
fn what_a_search_finds_fails_again() {
    // Two robots that are told to stop and are expected to reach their goals.
    let text = STRAIGHT.replace(
        "[[goals]]",
        "[[commands]]\nat_s = 6.0\nevery_s = 1.0\ncommand = \"stop\"\n[[goals]]",
    );
    let path = file(
        "search",
        &text.replace("duration_s = 25.0", "duration_s = 60.0\nrobots = 2"),
    );
    let found = path.with_file_name("found.toml");
    let scenario = path.to_str().expect("UTF-8");
    let out = found.to_str().expect("UTF-8");
    let output = evaluate(
        scenario,
        &[
            "--adversarial",
            "--hunt",
            "reach",
            "--budget",
            "60",
            "--out",
            out,
        ],
    );
    let text = said(&output.stdout);
    assert_eq!(
        output.status.code(),
        Some(1),
        "{text}{}",
        said(&output.stderr)
    );
    let again = text
        .lines()
        .find_map(|line| line.trim().strip_prefix("terracrawler evaluate "))
        .expect("how to see it again");
    let options: Vec<&str> = again.split_whitespace().skip(2).collect();
    let output = evaluate(out, &options);
    // How few robots it takes is the search's to find.
    let text = said(&output.stdout);
    assert!(
        text.contains("failed: 1 of 1 runs") && text.contains(" robots reached their goals"),
        "{text}"
    );
}

#[test]
fn mistakes_are_told_in_a_line() {
    let path = file("mistakes", &format!("{STRAIGHT}colour = 1\n"));
    let output = evaluate(path.to_str().expect("UTF-8"), &[]);
    assert_eq!(output.status.code(), Some(2));
    let text = said(&output.stderr);
    assert!(
        text.contains("scenario.toml: line 12, column 1: not a scenario: unknown field"),
        "{text}"
    );
    for (options, told) in [
        (&["--seeds", "0"][..], "invalid value '0'"),
        (&["--sweep", "robots"], "is not like key=least:most:points"),
        (&["--sweep", "colour=1,2"], "unknown field `colour`"),
        (&["--hunt", "luck", "--adversarial"], "`luck` is none of"),
        (&["--budget", "5"], "--adversarial"),
        (&["--robots", "0"], "nothing to evaluate"),
        (
            // Before a single run, or this would take a day.
            &["--csv", "/nowhere/x.csv", "--seeds", "1000000"],
            "cannot write /nowhere/x.csv",
        ),
    ] {
        let output = evaluate("empty", options);
        assert_eq!(output.status.code(), Some(2), "{options:?}");
        assert!(
            said(&output.stderr).contains(told),
            "{}",
            said(&output.stderr)
        );
    }
}
