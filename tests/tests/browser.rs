//! A person in front of the control room: the script drives a real browser against a real server.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crawler_tests::Terracrawler;

/// For robots to be online, on a busy machine.
const LIMIT: Duration = Duration::from_mins(2);

#[test]
fn the_control_room_shows_stops_and_drives_robots() {
    let server = Terracrawler::start(&["up", "--robots", "8", "--seed", "3"]);
    server.wait_online(8, LIMIT);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e"])
        .env("BASE_URL", server.url()));
}

/// Against a server of the page's own, which can be told to end sessions and to go away.
#[test]
fn people_log_in_and_are_shown_what_they_may_do() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:accounts"])
        .env_remove("BASE_URL"));
}

/// The same against a real one that is closed: what the page says of accounts is what the server does.
#[test]
fn people_log_in_to_a_real_server() {
    let server = Terracrawler::start_closed(&["up", "--robots", "8", "--seed", "3"]);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:accounts"])
        .env("BASE_URL", server.url())
        .env("INVITE", server.first_invitation()));
}

/// Against a server of the page's own as well: robots are drawn around, sent and driven.
#[test]
fn the_arena_obeys_mouse_fingers_keys_and_gamepads() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:arena"])
        .env_remove("BASE_URL"));
}

/// Against the same, with a hundred robots.
#[test]
fn an_operator_finds_looks_at_and_commands_robots() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:fleet"])
        .env_remove("BASE_URL"));
}

/// With a server of the page's own, in every state and size.
#[test]
fn a_simulated_world_is_seen_in_every_state_and_size() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:simulation"])
        .env_remove("BASE_URL"));
}

/// A scenario is loaded, things are put in and gone back to in a real world: what is dropped stands in it,
/// and robots come back to where they were when it was kept.
#[test]
fn a_real_world_is_loaded_furnished_and_gone_back_to() {
    let server = Terracrawler::start(&["up", "--robots", "4", "--seed", "3"]);
    server.wait_online(4, LIMIT);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:simulation"])
        .env("BASE_URL", server.url()));
}

/// An experiment is made with the usual values, runs to its end, and is compared with others.
#[test]
fn experiments_are_made_watched_and_compared() {
    let server = Terracrawler::start(&["up", "--robots", "2", "--seed", "3"]);
    server.wait_online(2, LIMIT);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:experiments"])
        .env("BASE_URL", server.url()));
}

/// Against a server of the page's own: all states, sizes and colours, and what goes wrong.
#[test]
fn experiments_are_seen_in_every_state_and_size() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:experiments"])
        .env_remove("BASE_URL"));
}

/// A genuine release is added, a forged one refused, and one is withdrawn.
#[test]
fn releases_are_added_and_withdrawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    release(&["keygen", "--out", &path("keys")]);
    let (image, file, forged) = (path("image"), path("virt.release"), path("forged.release"));
    std::fs::write(&image, vec![7; 100_000]).expect("an image");
    let options = "--board virt --version 0.4.0 --build abc123 --sequence 12 --expires 2099-01-31";
    let key = path("keys/release-key.pem");
    let mut arguments = vec!["sign", "--key", &key, "--image", &image, "--out", &file];
    arguments.extend(options.split(' '));
    release(&arguments);
    let mut bytes = std::fs::read(&file).expect("a release");
    *bytes.last_mut().expect("an image") ^= 1;
    std::fs::write(&forged, bytes).expect("written");

    let public = path("keys/release-public.pem");
    let server = Terracrawler::start(&["up", "--robots", "2", "--release-key", &public]);
    server.wait_online(2, LIMIT);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:updates"])
        .env("BASE_URL", server.url())
        .env("RELEASE", file)
        .env("FORGED", forged));
}

/// A good release reaches every robot, a bad one stops itself and says why, and the way back is open; whoever may only
/// look is offered nothing.
#[test]
fn rollouts_run_stop_by_themselves_and_go_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    release(&["keygen", "--out", &path("keys")]);
    let signed = |name: &str, bundle: &str, version: &str, build: &str, sequence: &str| {
        let (key, file) = (path("keys/release-key.pem"), path(name));
        let mut arguments = vec!["sign", "--key", &key, "--image", bundle, "--out", &file];
        arguments.extend(["--board", "sim", "--version", version, "--build", build]);
        arguments.extend(["--sequence", sequence]);
        release(&arguments);
        file
    };
    let bundle = |version: &str, build: &str, more: &[&str]| {
        let file = path(build);
        let mut arguments = vec!["bundle", "--version", version, "--build", build];
        arguments.extend(["--size", "100000", "--out", &file]);
        arguments.extend(more);
        release(&arguments);
        file
    };
    let good = bundle("0.4.0", "good-1", &[]);
    let bad = bundle("0.5.0", "bad-1", &["--defect", "panic=3000"]);
    let files = [
        (
            "GOOD",
            signed("good.release", &good, "0.4.0", "good-1", "1"),
        ),
        ("BAD", signed("bad.release", &bad, "0.5.0", "bad-1", "2")),
        (
            "AGAIN",
            signed("again.release", &good, "0.4.0", "good-1", "3"),
        ),
    ];

    let public = path("keys/release-public.pem");
    let options = ["--robots", "4", "--scenario", "empty", "--release-key"];
    let server = Terracrawler::start_closed(&[&["up"], &options[..], &[&public]].concat());
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:rollouts"])
        .env("BASE_URL", server.url())
        .env("INVITE", server.first_invitation())
        .envs(files));
}

/// Against a server of the page's own: rollouts in every state and size.
#[test]
fn rollouts_are_seen_in_every_state_and_size() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:rollouts"])
        .env_remove("BASE_URL"));
}

/// Against a server of the page's own: releases in every state and size.
#[test]
fn releases_are_seen_in_every_state_and_size() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:updates"])
        .env_remove("BASE_URL"));
}

/// A past of its own, with gaps and troubles: the mock's.
#[test]
fn the_past_is_looked_at_by_mouse_and_keys() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:history"])
        .env_remove("BASE_URL"));
}

/// What robots did a moment ago is what the page about the past shows, and what its link shows others.
#[test]
fn the_past_is_where_robots_were() {
    let server = Terracrawler::start(&["up", "--robots", "8", "--seed", "3"]);
    server.wait_online(8, LIMIT);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:history"])
        .env("BASE_URL", server.url()));
}

/// Questions that fail, that are ended and that wait for others: the mock's.
#[test]
fn what_if_is_asked_by_mouse_and_keys() {
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:what-if"])
        .env_remove("BASE_URL"));
}

/// A robot that is told to stop in a recorded moment stays in the one world, and goes on in the other.
#[test]
fn what_if_a_robot_had_been_told_to_stop() {
    let server = Terracrawler::start(&["up", "--robots", "8", "--seed", "3"]);
    server.wait_online(8, LIMIT);
    run(Command::new("npm")
        .args(["run", "--silent", "e2e:what-if"])
        .env("BASE_URL", server.url()));
}

/// Runs `terracrawler release` and fails with what it said.
fn release(arguments: &[&str]) {
    let mut command = Command::new(crawler_tests::binary());
    let output = command.arg("release").args(arguments).output();
    let output = output.expect("runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
}

/// Runs a script of the control room and fails with what it said.
fn run(command: &mut Command) {
    let ui = Path::new(env!("CARGO_MANIFEST_DIR")).join("../host-server/ui");
    assert!(
        ui.join("node_modules").is_dir() && ui.join("dist/index.html").is_file(),
        "the control room is not installed and built: cargo xtask ui"
    );
    let output = command
        .current_dir(ui)
        .output()
        .expect("npm is missing: cargo xtask setup");
    let shown = String::from_utf8_lossy(&output.stdout);
    println!("{shown}");
    assert!(
        output.status.success(),
        "{shown}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
