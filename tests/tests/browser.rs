//! A person in front of the control room: the script drives a real browser against a real server.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crawler_tests::Terracrawler;

#[test]
fn the_control_room_shows_stops_and_drives_robots() {
    let server = Terracrawler::start(&["up", "--robots", "8", "--seed", "3"]);
    server.wait_online(8, Duration::from_secs(30));
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
