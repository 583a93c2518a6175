//! Robots and a server of different versions: `mixed_versions PROGRAM`, where PROGRAM is another `terracrawler`.
//!
//! Its robots meet the server of this version, and its server the robots of this one. Either way the robots are
//! known, told what to do, and obey, and nothing that they say is refused. The deep tier builds PROGRAM from an
//! earlier commit: `xtask/src/mixed.rs`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crawler_tests::measure::{metrics, sum};
use crawler_tests::{Simulated, Terracrawler, binary, wait_for};
use serde_json::{Value, json};

const ROBOTS: usize = 5;
/// Samples of all robots that the server takes in.
const SAMPLES: f64 = 100.0;
const PATIENCE: Duration = Duration::from_mins(2);

fn main() {
    let other = std::env::args().nth(1).expect("mixed_versions PROGRAM");
    let (own, other) = (binary(), PathBuf::from(other));
    for (what, server, robots) in [
        ("other robots at this server", &own, &other),
        ("these robots at the other server", &other, &own),
    ] {
        meet(server, robots);
        println!("{what}: known, obedient, and nothing refused");
    }
}

fn meet(server: &Path, robots: &Path) {
    let server = Terracrawler::start_program(server, &["serve"]);
    let count = ROBOTS.to_string();
    let words = ["--robots", &count, "--seed", "1"];
    let _robots = Simulated::start_program(robots, server.mqtt(), &words);
    server.wait_online(ROBOTS, PATIENCE);
    let set = json!({ "command": "set", "parameters": { "safe_distance_mm": 321 } });
    for command in [
        json!({ "command": "stop" }),
        json!({ "command": "identify" }),
        set,
    ] {
        for robot in 1..=ROBOTS {
            obeys(&server, &format!("sim-{robot:04}"), &command);
        }
    }
    wait_for("samples", PATIENCE, || {
        let taken = "terracrawler_mqtt_messages_in_total{kind=\"telemetry\"}";
        (sum(&metrics(&server), taken) >= SAMPLES).then_some(())
    });
    let refused = sum(
        &metrics(&server),
        "terracrawler_mqtt_messages_rejected_total",
    );
    assert!(refused == 0.0, "{refused} messages were refused");
}

/// Gives a command, and waits until the robot has carried it out.
fn obeys(server: &Terracrawler, robot: &str, command: &Value) {
    let (status, given) = server.post(&format!("/api/v1/robots/{robot}/commands"), command);
    assert_eq!(status, 202, "{robot} {command}: {given}");
    let id = given["id"].as_str().expect("an id");
    let counts = wait_for("an answer", PATIENCE, || {
        let (_, record) = server.get(&format!("/api/v1/commands/{id}"));
        let open = |name| record["counts"][name].as_u64().unwrap_or(0);
        (open("pending") + open("accepted") == 0).then(|| record["counts"].clone())
    });
    assert_eq!(counts["completed"], 1, "{robot} {command}: {counts}");
}
