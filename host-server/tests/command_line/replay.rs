//! `terracrawler replay`, as a person calls it.

use std::io::Write as _;
use std::process::{Command, Output, Stdio};

use crate::folder::Folder;

fn replay(words: &[&str]) -> (Option<i32>, String) {
    piped(words, b"")
}

/// Runs it with something on its standard input; returns its exit code and all that it said.
fn piped(words: &[&str], input: &[u8]) -> (Option<i32>, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_terracrawler"))
        .arg("replay")
        .args(words)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it runs");
    // One that has heard enough hangs up.
    let _ = child.stdin.take().expect("a pipe").write_all(input);
    let Output {
        status,
        stdout,
        stderr,
    } = child.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&stdout).into_owned();
    (status.code(), said + &String::from_utf8_lossy(&stderr))
}

#[test]
fn a_recorded_world_does_the_same_and_with_other_parameters_something_else() {
    let folder = Folder::new();
    let file = folder.file("world.mcap");
    let world = ["--scenario", "arena", "--robots", "2", "--seed", "5"];
    let (code, said) = replay(&[&world[..], &["--until", "12", "--record", &file]].concat());
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("12.000000 s, 2 robots"), "{said}");

    let (code, said) = replay(&[&file]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("2 of 2 robots do the same"), "{said}");

    let (code, said) = replay(&[&file, "--set", "safe_distance_mm=1500"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("sim-0001: parts in boot 1, at "), "{said}");
    assert!(said.contains("recorded") && said.contains("now"), "{said}");

    let whole = std::fs::read(&file).expect("it is there");
    std::fs::write(&file, &whole[..whole.len() / 2]).expect("room");
    let (code, said) = replay(&[&file]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("cut off"), "{said}");
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 4;
    std::fs::write(&file, &changed).expect("room");
    let (code, said) = replay(&[&file]);
    assert_eq!(code, Some(2), "{said}");
    for (words, told) in [
        (&["nowhere.mcap"][..], "nowhere.mcap: "),
        (&["/dev/null"], "not a usable recording"),
        (&["--restore", "/dev/null"], "not a usable snapshot"),
        (&["--scenario", "nowhere"], "neither a scenario"),
        (&["--scenario", "empty", "--set", "colour=1"], "colour"),
        (
            &["--scenario", "simple-navigation", "--difficulty", "7"],
            "0 to 1",
        ),
        (&["--scenario", "empty", "--robots", "70000"], "at most"),
    ] {
        let (code, said) = replay(words);
        assert_eq!(code, Some(2), "{words:?}: {said}");
        assert!(said.contains(told), "{words:?}: {said}");
    }
}

#[test]
fn a_recorded_run_is_asked_what_if() {
    let folder = Folder::new();
    let file = folder.file("run.mcap");
    let world = ["--scenario", "arena", "--robots", "3", "--seed", "5"];
    let inputs = b"run 5\ncommand all {\"command\":\"behave\",\"parameters\":{\"behaviour\":\"wander\"}}\nrun 20\n";
    let words = [&world[..], &["--interactive", "--record", &file]].concat();
    let (code, said) = piped(&words, inputs);
    assert_eq!(code, Some(0), "{said}");

    let (code, said) = replay(&[&file, "--what-if", "heal 1", "--at", "10"]);
    assert_eq!(code, Some(0), "{said}");
    for told in [
        "arena seed 5, made again up to 25.0 s, the same in all 25 seconds",
        "what if, at 10.0 s: heal 1",
        "none of 3 robots is elsewhere at any moment",
    ] {
        assert!(said.contains(told), "no `{told}` in {said}");
    }
    let asked = [
        &file,
        "--what-if",
        "set all max_speed=0.1",
        "--what-if",
        "inject sim-0002 battery-sag",
        "--at",
        "12",
    ];
    let (code, said) = replay(&[&asked[..], &["--until", "40", "--seeds", "3"]].concat());
    assert_eq!(code, Some(2), "a sag is of so many volts: {said}");
    let asked = [&asked[..4], &["inject sim-0002 ranger-dead", "--at", "12"]].concat();
    let (code, said) = replay(&[&asked[..], &["--until", "40", "--seeds", "3"]].concat());
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.contains("robots are elsewhere at some moment"),
        "{said}"
    );
    assert!(said.contains("the same asked of 3 other seeds"), "{said}");
    let rows: Vec<_> = said
        .lines()
        .filter(|row| row.starts_with("distance_m "))
        .collect();
    let [one, others] = rows[..] else {
        panic!("{said}");
    };
    let numbers = |row: &str| -> Vec<f64> {
        let words = row
            .split_whitespace()
            .skip(1)
            .map(|word| word.trim_end_matches(','));
        words.filter_map(|word| word.parse().ok()).collect()
    };
    let [was, would] = numbers(one)[..] else {
        panic!("{one}");
    };
    assert!(would < was, "{one}");
    // As it was, what if, by how much, from, to.
    let [_, _, by, low, high] = numbers(others)[..] else {
        panic!("{others}");
    };
    assert!(low <= by && by <= high && by < 0.0, "{others}");

    for (words, told) in [
        (
            &[&file[..], "--what-if", "run 5"][..],
            "`run` does nothing to a world",
        ),
        (
            &[&file, "--what-if", "heal 9"],
            "heal 9: there is no robot `9`",
        ),
        (
            &[&file, "--what-if", "heal 1", "--at", "60"],
            "the run ends after 25.0 s",
        ),
        (&[&file, "--until", "5"], "--until is for"),
        (
            &["/dev/null", "--what-if", "heal 1"],
            "not a usable recording",
        ),
        (&["--what-if", "heal 1"], "required"),
    ] {
        let (code, said) = replay(words);
        assert_eq!(code, Some(2), "{words:?}: {said}");
        assert!(said.contains(told), "{words:?}: {said}");
    }
}

#[test]
fn a_world_obeys_what_comes_through_a_pipe() {
    let folder = Folder::new();
    let kept = folder.file("kept.snapshot");
    let world = ["--scenario", "resilience", "--seed", "17"];
    let world = [&world[..], &["--until", "6", "--interactive"]].concat();
    let script = format!(
        "# a remark\nstep 5\nrun 0.95\nsnapshot {kept}\ninject sim-0001 ranger-dead\nrun 3\n\
         show sim-0001\nhash\nrestore {kept}\nreset 4\nquit\nnonsense\n"
    );
    let (code, said) = piped(&world, script.as_bytes());
    assert_eq!(code, Some(0), "{said}");
    for told in [
        "seed 17: 6.050000 s, 4 robots",
        "seed 17: 7.000000 s, 4 robots",
        "seed 17: 10.000000 s, 4 robots",
        "sim-0001  x ",
        "ERROR",
        "seed 4: 0.000000 s",
    ] {
        assert!(said.contains(told), "no `{told}` in {said}");
    }
    let then: Vec<_> = said.lines().filter(|l| l.contains(" 7.000000 s")).collect();
    assert!(then.len() > 1 && then[0] == then[then.len() - 1], "{said}");
    let (code, said) = replay(&["--restore", &kept]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("7.000000 s, 4 robots"), "{said}");

    let endless = vec![b'x'; 3_000_000];
    for (input, told) in [
        (&b"fly\nstep\n"[..], "error: `fly` is no command"),
        (b"run nan\n", "error: must be a number of seconds"),
        (b"step -1\n", "`-1` is no step"),
        (b"inject sim-0009 ranger-dead\n", "sim-0009"),
        (b"snapshot /nowhere/at/all\n", "/nowhere/at/all"),
        (b"\xff\xfe\n", "a line that is no text"),
        (&endless, "a line of more than 65536 bytes"),
    ] {
        let (code, said) = piped(&["--scenario", "empty", "--interactive"], input);
        assert_eq!(code, Some(2), "{said:.500}");
        assert!(said.contains(told), "{said:.500}");
        assert!(said.len() < 1_000, "it does not say it all again");
    }
}
