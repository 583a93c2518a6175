//! `terracrawler twin`, as a person calls it.

use std::process::{Command, Output};

use crate::folder::Folder;

fn run(words: &[&str]) -> (Option<i32>, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = Command::new(env!("CARGO_BIN_EXE_terracrawler"))
        .args(words)
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&stdout).into_owned();
    (status.code(), said + &String::from_utf8_lossy(&stderr))
}

/// The number in front of a text, centimetres.
fn before(line: &str, text: &str) -> f64 {
    let part = line.split(text).next().expect("some").trim();
    let number = part.rsplit([' ', ':']).next().expect("a word");
    number.parse().unwrap_or_else(|_| panic!("{line}"))
}

#[test]
fn a_simulated_robot_is_calibrated_shown_and_exported() {
    let folder = Folder::new();
    let (scenario, file) = (folder.file("calibration.toml"), folder.file("run.mcap"));
    let (code, said) = run(&["twin", "script"]);
    assert_eq!(code, Some(0), "{said}");
    std::fs::write(&scenario, said).expect("written");
    // Bodies that the server is not told of: their parameters are drawn from the widest ranges.
    let record = |seed: &str, until: &str| {
        let world = [
            "replay",
            "--scenario",
            &scenario,
            "--randomisation",
            "wild",
            "--seed",
            seed,
        ];
        let (code, said) = run(&[&world[..], &["--until", until, "--record", &file]].concat());
        assert_eq!(code, Some(0), "{said}");
    };
    record("7", "126");
    let certificate = folder.file("sim-0001.json");
    let calibrate = ["twin", "calibrate", &file, "--floor", "lino"];
    let (code, said) = run(&[&calibrate[..], &["--out", &certificate]].concat());
    assert_eq!(code, Some(0), "{said}");
    let ahead = said
        .lines()
        .find(|line| line.contains("10 s ahead"))
        .expect("a validation");
    let (own, nominal) = ahead.split_once("; nominal").expect("both");
    let (own, nominal) = (own.rsplit_once(": ").expect("errors").1, nominal.trim());
    let (own, nominal) = (before(own, " cm"), before(nominal, " cm"));
    assert!(own < 8.0 && own < nominal / 3.0, "{ahead}");

    let (code, shown) = run(&["twin", "show", &certificate]);
    assert_eq!(code, Some(0), "{shown}");
    assert!(
        shown.contains("of sim-0001, program ") && shown.contains(", on lino"),
        "{shown}"
    );
    let (code, exported) = run(&["twin", "export", &certificate]);
    assert_eq!(code, Some(0), "{exported}");
    let motors = exported.lines().find(|line| line.starts_with("motors = "));
    assert!(
        exported.contains("[[bodies]]") && motors.is_some(),
        "{exported}"
    );
    let own = folder.file("own.toml");
    let text = format!("name = \"own\"\nrobots = 1\n\n{exported}");
    std::fs::write(&own, text).expect("written");
    let (code, said) = run(&["replay", "--scenario", &own, "--seed", "1", "--until", "1"]);
    assert_eq!(code, Some(0), "{said}");

    // A healthy robot is followed without a word, whatever is said by another's body.
    let follow = ["twin", "follow", &file];
    let (code, said) = run(&[&follow[..], &["--certificate", &certificate]].concat());
    assert_eq!(code, Some(0), "{said}");
    let ahead = said.lines().find(|line| line.contains("10 s ahead"));
    let (_, errors) = ahead.expect("residuals").rsplit_once(": ").expect("errors");
    assert!(before(errors, " cm") < 8.0, "{said}");
    let (_, said) = run(&follow);
    assert!(said.contains("by the nominal body"), "{said}");

    // The same drive once more is no better than itself.
    let (code, said) = run(&[&calibrate[..], &["--previous", &certificate]].concat());
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("not_better_than_previous"), "{said}");
    // A minute of it has nothing to validate on, or too little to find anything.
    record("7", "20");
    let (code, said) = run(&calibrate);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("no certificate ("), "{said}");
}

#[test]
fn files_that_cannot_be_used_are_named() {
    let folder = Folder::new();
    let file = folder.file("drive.csv");
    std::fs::write(&file, "t,x,y\n1,2,3\n").expect("written");
    for words in [
        &["twin", "import", &file, "--robot", "lab-3"][..],
        &["twin", "calibrate", &file],
        &["twin", "show", &file],
        &["twin", "export", "/nowhere.json"],
    ] {
        let (code, said) = run(words);
        assert_eq!(code, Some(2), "{words:?}: {said}");
        assert!(said.starts_with("terracrawler: "), "{said}");
    }
    // Nobody moved: no certificate, and no error.
    let head = "t,duty_left,duty_right,voltage,x,y,theta\n";
    let rows = (0..600)
        .map(|i| format!("{},0,0,7.4,1,1,0\n", f64::from(i) * 0.1))
        .collect::<Vec<_>>()
        .concat();
    std::fs::write(&file, format!("{head}{rows}")).expect("written");
    let (code, said) = run(&["twin", "import", &file, "--robot", "lab-3"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(
        said.contains("no certificate (unidentified): the robot hardly moved"),
        "{said}"
    );
}
