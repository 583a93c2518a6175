//! A person in front of the control room: the script drives a real browser against a real server.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crawler_tests::Terracrawler;

#[test]
fn the_control_room_shows_stops_and_drives_robots() {
    let ui = Path::new(env!("CARGO_MANIFEST_DIR")).join("../host-server/ui");
    assert!(
        ui.join("node_modules").is_dir(),
        "the control room is not installed: cargo xtask ui"
    );
    let server = Terracrawler::start(&["up", "--robots", "8", "--seed", "3"]);
    server.wait_online(8, Duration::from_secs(30));
    let output = Command::new("npm")
        .args(["run", "--silent", "e2e"])
        .env("BASE_URL", server.url())
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
