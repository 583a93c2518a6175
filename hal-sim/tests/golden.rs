//! The golden messages of the protocol: what a robot of this build is told and what it says.
//!
//! Later builds read them (`firmware/protocol/tests/golden.rs`, `host-server/tests/server/mixed.rs`), so that
//! a robot that was built today and is never updated is understood. Written once for each version of the
//! protocol; to write them for a new one:
//!
//! ```console
//! cargo test -p crawler-sim --test suite -- --ignored golden
//! ```

use std::collections::BTreeSet;
use std::fmt::Write as _;

use crawler_detector::BLOB;
use crawler_hal::Duration;
use crawler_protocol::{PROTOCOL_VERSION, RobotId, Topic};
use crawler_sim::net::lockstep::{Origin, Published};
use crawler_sim::run::Simulation;

use crate::common::{scenario, settle};

/// A message and what it came on, as a line of JSON.
fn line(topic: &str, payload: &[u8], content_type: Option<&str>) -> String {
    let body = match std::str::from_utf8(payload) {
        Ok(text) if content_type.is_none() => serde_json::json!({ "topic": topic, "text": text }),
        _ => {
            let hex = payload.iter().fold(String::new(), |mut hex, byte| {
                let _ = write!(hex, "{byte:02x}");
                hex
            });
            serde_json::json!({ "topic": topic, "content_type": content_type, "hex": hex })
        }
    };
    body.to_string()
}

/// What servers and trackers tell robots of this version beside commands.
const TOLD: [(&str, &str); 3] = [
    ("swarm/time", r#"{"timestamp":1767225605500}"#),
    (
        "swarm/cell/0/-1",
        r#"{"x":0,"y":-1,"timestamp":1767225605500,"count":2,"robots":[{"id":"sim-0002","x":0.5,"y":-0.25,"theta":1.5,"v":0.25,"w":-0.5}]}"#,
    ),
    (
        "swarm/pose/sim-0001",
        r#"{"robot":"sim-0001","timestamp":1767225605500,"pose":{"x":0.5,"y":-0.25,"theta":1.5,"sigma":0.01}}"#,
    ),
];

/// Everything that is said, once of each sort.
#[derive(Default)]
struct Golden {
    lines: Vec<String>,
    sorts: BTreeSet<String>,
}

impl Golden {
    fn hear(&mut self, simulation: &Simulation, content_type: Option<&str>) {
        for message in simulation.network().expect("lockstep").take_record() {
            let Published {
                topic,
                payload,
                origin,
                ..
            } = message;
            let parsed = Topic::parse(simulation.fleet(), &topic).expect("a topic");
            let text = String::from_utf8_lossy(&payload);
            let field = |name: &str| {
                let (_, rest) = text.split_once(&format!("\"{name}\":")).unwrap_or_default();
                rest.split(',').next().unwrap_or_default().to_owned()
            };
            let (sort, content_type) = match parsed {
                Topic::Image(_) => continue,
                // Every answer belongs to its command.
                Topic::Response(_) => (text.clone().into_owned(), None),
                Topic::Status(_) => (format!("status {origin:?} {}", field("cause")), None),
                Topic::Heartbeat(_) => (format!("heartbeat {}", field("state")), None),
                // Samples of the encoding before may still come behind the command that changed it.
                Topic::Telemetry(_) if payload.first() == Some(&b'{') => {
                    let sort = format!("telemetry {} {}", field("state"), field("behaviour"));
                    (sort, None)
                }
                Topic::Telemetry(_) => {
                    let Some(content_type) = content_type else {
                        continue;
                    };
                    let sequence = payload.first() == Some(&0x1e);
                    if sequence != content_type.contains("json") {
                        continue;
                    }
                    (format!("telemetry {content_type}"), Some(content_type))
                }
                Topic::Logs(_) => (format!("log {}", field("event")), None),
                Topic::Vision(_) => (format!("vision {}", text.contains("class")), None),
                other => (format!("{other:?}"), None),
            };
            if origin != Origin::Repeated && self.sorts.insert(sort) {
                self.lines.push(line(&topic, &payload, content_type));
            }
        }
    }
}

#[test]
#[ignore = "writes the golden messages of this version of the protocol"]
fn golden_messages_are_written() {
    let mut world = scenario("search", 1);
    world.command = None;
    world.spawn.camera_share = 1.0;
    world.detector = Some(BLOB);
    let mut simulation = Simulation::lockstep(world, 5).expect("a world");
    simulation.network().expect("lockstep").record(200_000);
    settle(&mut simulation);
    let mut golden = Golden::default();
    golden.hear(&simulation, None);

    let robot = RobotId::new("sim-0001").expect("an id");
    let topic = Topic::CommandRobot(robot).render(simulation.fleet());
    let steps: [(&str, u64, Option<&str>); 24] = [
        (r#""identify""#, 2, None),
        (
            r#""set","parameters":{"safe_distance_mm":600,"max_speed":0.8}"#,
            2,
            None,
        ),
        (r#""set","parameters":{"safe_distance_mm":600000}"#, 1, None),
        (
            r#""move","parameters":{"direction":"forward","speed":60,"duration":1000}"#,
            3,
            None,
        ),
        (
            r#""move","parameters":{"direction":"left","speed":40,"duration":500}"#,
            2,
            None,
        ),
        (r#""drive","parameters":{"v":0.2,"w":0.5}"#, 2, None),
        (r#""stop""#, 2, None),
        (r#""scan""#, 20, None),
        (r#""capture""#, 5, None),
        (r#""goto","parameters":{"x":1.5,"y":1.0}"#, 5, None),
        (
            r#""behave","parameters":{"behaviour":"wander","speed":60}"#,
            30,
            None,
        ),
        (r#""behave","parameters":{"behaviour":"disperse"}"#, 3, None),
        (r#""behave","parameters":{"behaviour":"gather"}"#, 3, None),
        (r#""behave","parameters":{"behaviour":"flock"}"#, 3, None),
        (r#""behave","parameters":{"behaviour":"dance"}"#, 1, None),
        (r#""behave","parameters":{"behaviour":"manual"}"#, 3, None),
        (r#""estop""#, 2, None),
        (
            r#""move","parameters":{"direction":"backward","speed":10,"duration":0}"#,
            2,
            None,
        ),
        (r#""reset""#, 2, None),
        (
            r#""set","parameters":{"telemetry_format":1}"#,
            2,
            Some("application/cbor"),
        ),
        (
            r#""set","parameters":{"telemetry_batch":5}"#,
            5,
            Some("application/cbor-seq"),
        ),
        (
            r#""set","parameters":{"telemetry_format":0,"telemetry_batch":2}"#,
            5,
            Some("application/json-seq"),
        ),
        (r#""set","parameters":{"telemetry_batch":1}"#, 2, None),
        (r#""reboot""#, 10, None),
    ];
    for (number, (command, seconds, content_type)) in steps.into_iter().enumerate() {
        let seq = number as u64 + 1;
        let timestamp = simulation.unix_ms();
        let command = format!(
            r#"{{"command":{command},"timestamp":{timestamp},"seq":{seq},"source":"operator:ada"}}"#
        );
        golden.lines.push(line(&topic, command.as_bytes(), None));
        simulation.submit_raw(0, command.as_bytes());
        // What was collected before is written as before.
        simulation.run_for(Duration::from_secs(1));
        golden.hear(&simulation, content_type);
        simulation.run_for(Duration::from_secs(seconds));
        golden.hear(&simulation, content_type);
    }
    for (topic, text) in TOLD {
        golden.lines.push(line(topic, text.as_bytes(), None));
    }
    let path = format!(
        "{}/../firmware/protocol/golden/protocol-{PROTOCOL_VERSION}.jsonl",
        env!("CARGO_MANIFEST_DIR")
    );
    std::fs::write(&path, golden.lines.join("\n") + "\n").expect(&path);
}
