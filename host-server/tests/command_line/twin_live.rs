//! `terracrawler twin calibrate --live`, and a server that is killed in the middle of it.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};

use crate::LIMIT;
use crate::console::Place;

/// A robot whose body nobody knows, under a camera.
const WORLD: &str = "name = \"bench\"\nabout = \"A robot.\"\nrobots = 1\nrandomisation = \"wild\"\n\
    [arena]\nwidth = 4.0\nheight = 4.0\n[spawn]\nposes = [{ x = 0.0, y = 0.0, theta = 1.0 }]\n\
    [tracker]\nrate_hz = 10.0\n";

/// A server, killed when it goes: it has no time to say anything.
pub(crate) struct Server(Child);

impl Server {
    pub(crate) fn start(place: &Place) -> Self {
        let file = place.path().join("bench.toml");
        std::fs::create_dir_all(place.path()).expect("made");
        std::fs::write(&file, WORLD).expect("written");
        let any = [
            "up",
            "--open",
            "--http",
            "127.0.0.1:0",
            "--mqtt",
            "127.0.0.1:0",
        ];
        let mut command = place.command(&any);
        command.arg("--scenario").arg(&file).args(["--log", "off"]);
        let child = command.stdout(Stdio::piped()).spawn();
        let mut server = Self(child.expect("starts"));
        let mut lines = BufReader::new(server.0.stdout.take().expect("stdout"));
        let mut greeting = String::new();
        while !greeting.contains("Ctrl-C") {
            let read = lines.read_line(&mut greeting).expect("reads");
            assert!(read > 0, "ended after {greeting}");
        }
        server
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn said(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    String::from_utf8_lossy(&output.stdout).into_owned() + &errors
}

/// Asks until the robot may begin.
fn until_permitted(place: &Place, options: &[&str]) -> String {
    let begun = Instant::now();
    loop {
        let ask = ["twin", "calibrate", "--live", "sim-0001"];
        let output = place.run(&[&ask[..], options].concat());
        let words = said(&output);
        if output.status.code() == Some(0) {
            return words;
        }
        assert_eq!(output.status.code(), Some(1), "{words}");
        assert!(begun.elapsed() < LIMIT, "{words}");
        std::thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn a_server_that_is_killed_while_a_robot_drives_says_so_afterwards() {
    let place = Place::new();
    let server = Server::start(&place);
    let words = until_permitted(&place, &["--around", "1.8"]);
    assert!(
        words.contains("would drive for") && words.contains("--confirmed"),
        "{words}"
    );
    let small = ["twin", "calibrate", "--live", "sim-0001", "--around", "0.6"];
    let small = place.run(&small);
    assert_eq!(small.status.code(), Some(1), "{}", said(&small));
    assert!(
        said(&small).contains("may not begin (leaves)"),
        "{}",
        said(&small)
    );
    let begin = [
        "twin",
        "calibrate",
        "--live",
        "sim-0001",
        "--confirmed",
        "--floor",
        "lino",
    ];
    let mut child = place
        .command(&begin)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    let mut lines = BufReader::new(child.stdout.take().expect("stdout"));
    let mut words = String::new();
    while !words.contains("baseline") {
        let read = lines.read_line(&mut words).expect("reads");
        assert!(read > 0, "ended after {words}");
    }
    drop(server);
    let output = child.wait_with_output().expect("ends");
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));

    let server = Server::start(&place);
    until_permitted(&place, &[]);
    let files = std::fs::read_dir(place.path().join("calibrations")).expect("a folder");
    let texts: Vec<_> = files
        .map(|file| std::fs::read_to_string(file.expect("a file").path()).expect("text"))
        .collect();
    assert!(
        matches!(&texts[..], [text] if text.contains("\"broken_off\"") && text.contains("server_ended")),
        "{texts:?}"
    );
    assert!(!place.path().join("twins/sim-0001.json").exists());
    drop(server);
}

#[test]
fn a_live_calibration_and_a_recording_exclude_each_other() {
    for words in [
        &["twin", "calibrate"][..],
        &["twin", "calibrate", "run.mcap", "--live", "a"],
        &["twin", "calibrate", "run.mcap", "--confirmed"],
        &["twin", "calibrate", "--live", "a", "--out", "b.json"],
        &["twin", "calibrate", "--live", "A B"],
    ] {
        let output = Place::new().run(words);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{words:?}: {}",
            said(&output)
        );
    }
}
