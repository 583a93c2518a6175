use super::*;
use crate::replay::session::Session;
use crawler_sim::scenario::Scenario;

fn session(seed: u64) -> Session {
    let scenario = Scenario::built_in("arena").expect("there").with_robots(2);
    Session::new(scenario, seed, None, String::new()).expect("sound")
}

fn say(session: &mut Session, lines: &str) -> (ExitCode, String) {
    let mut output = Vec::new();
    let code = run(session, lines.as_bytes(), &mut output, false).expect("writes");
    (code, String::from_utf8(output).expect("text"))
}

/// The last fingerprint in what was said.
fn hash(said: &str) -> &str {
    said.rsplit("hash ")
        .next()
        .expect("one")
        .get(..16)
        .expect("whole")
}

#[test]
fn a_world_is_stepped_kept_changed_and_taken_back() {
    let file = std::env::temp_dir().join(format!("crawler-prompt-{}.snap", std::process::id()));
    let name = file.to_str().expect("a plain path");
    let mut session = session(3);
    let (_, said) = say(
        &mut session,
        "# nothing\n\nuntil 5.5\nstep\nstep 2 control\n",
    );
    assert!(
        said.contains("5.500000 s") && said.contains("5.540000 s"),
        "{said}"
    );
    let kept = hash(&said).to_owned();
    let (_, said) = say(
        &mut session,
        &format!(
            "snapshot {name}\ninject 1 ranger-dead\nset sim-0002 safe_distance_mm=700\n\
             command all {{\"command\":\"stop\"}}\nadd\nremove 1\nrun 2\nrobots\njournal\n"
        ),
    );
    assert!(
        said.contains("added sim-0003") && said.contains("5 inputs, 0 lost"),
        "{said}"
    );
    assert!(!said.contains("sim-0001 "), "{said}");
    let (code, said) = say(
        &mut session,
        &format!("restore {name}\nshow sim-0001\nhash\n"),
    );
    assert_eq!(code, ExitCode::SUCCESS, "{said}");
    assert_eq!(hash(&said), kept);
    let (_, said) = say(&mut session, "reset 9\nuntil 1\nreset 3\nuntil 5.54\n");
    assert_eq!(hash(&said), kept);
    std::fs::remove_file(file).expect("it was there");
}

#[test]
fn things_are_dropped_and_taken_away() {
    let mut session = session(3);
    let ball = r#"{"object":{"shape":"ball","x":0,"y":0,"size":0.02,"colour":"red"}}"#;
    let (code, said) = say(
        &mut session,
        &format!("remove 1\nremove 2\ndrop {ball}\njournal\n"),
    );
    assert_eq!(code, ExitCode::SUCCESS, "{said}");
    assert!(
        said.contains("item 1\n") && said.contains("3 inputs"),
        "{said}"
    );
    let (code, said) = say(&mut session, "take 1\ntake 1\n");
    assert_eq!(code, ExitCode::from(2), "{said}");
    assert!(said.contains("number `1`"), "{said}");
}

#[test]
fn a_script_ends_at_the_first_line_that_fails() {
    for bad in [
        "fly",
        "show sim-0009",
        "step 0",
        "step sideways",
        "run -1",
        "run nan",
        "speed 0",
        "inject 1 nonsense",
        "inject 1 {\"fault\":\"line-noise\",\"flips\":2}",
        "command 1 {\"command\":\"fly\"}",
        "set 1 nothing",
        "add 1 2",
        "add 1000 0 0",
        "drop",
        "drop {\"obstacle\":{\"shape\":\"circle\",\"x\":99,\"y\":0,\"r\":0.2}}",
        "drop {\"obstacle\":{\"shape\":\"circle\",\"x\":0,\"y\":0}}",
        "take 1",
        "take x",
        "restore /nowhere/at/all",
        "snapshot /nowhere/at/all",
        "reset x",
        "record",
    ] {
        let (code, said) = say(&mut session(1), &format!("{bad}\nstep\n"));
        assert_eq!(code, ExitCode::from(2), "{bad}: {said}");
        assert_eq!(said.lines().count(), 1, "{bad}: {said}");
        assert!(said.starts_with("error: "), "{bad}: {said}");
    }
}

#[test]
fn a_world_at_hand_is_recorded_from_its_beginning() {
    let file = std::env::temp_dir().join(format!("crawler-prompt-{}.mcap", std::process::id()));
    let name = file.to_str().expect("a plain path");
    let mut session = session(4);
    let (_, plain) = say(&mut session, "until 6\nremove 2\nuntil 8\n");
    let (_, said) = say(
        &mut session,
        &format!("reset\nuntil 6\nremove 2\nrecord {name}\nreset\n"),
    );
    assert!(said.contains("record off"), "{said}");
    let (_, said) = say(&mut session, "until 8\nrecord off\n");
    assert_eq!(hash(said.lines().next().expect("a line")), hash(&plain));
    let recording = std::fs::File::open(&file).expect("a file");
    let recording = crawler_sim::tools::replay::Recording::read(recording).expect("a recording");
    assert_eq!(recording.end_us(), 8_000_000);
    assert_eq!(recording.robots().count(), 2);
    std::fs::remove_file(file).expect("it was there");
}
