//! A fleet of mixed versions: robots that are older than the server, and newer ones.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crawler_protocol::TelemetryEncoding;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::PublishProperties;
use serde_json::{Value, json};

use crate::support::{FakeRobot, Fixture, eventually, status, telemetry};

/// What robots and servers of version 1 of the protocol have said, line by line.
fn golden() -> Vec<Value> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/protocol/golden/protocol-1.jsonl");
    let text = std::fs::read_to_string(&path).expect("the golden messages");
    let lines = text.lines().map(serde_json::from_str::<Value>);
    lines.map(|line| line.expect("a line of JSON")).collect()
}

fn bytes(line: &Value) -> Vec<u8> {
    match (line["text"].as_str(), line["hex"].as_str()) {
        (Some(text), _) => text.into(),
        (None, Some(hex)) => (0..hex.len() / 2)
            .map(|at| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16).expect("hex"))
            .collect(),
        _ => panic!("neither text nor bytes: {line}"),
    }
}

async fn say(robot: &FakeRobot, topic: &str, content_type: Option<&str>, payload: Vec<u8>) {
    let retained = topic.starts_with("swarm/status/") || topic.starts_with("swarm/parameters/");
    let properties = PublishProperties {
        content_type: content_type.map(str::to_owned),
        ..PublishProperties::default()
    };
    robot
        .client
        .publish_with_properties(topic, QoS::AtLeastOnce, retained, payload, properties)
        .await
        .expect("publish");
}

/// Gives the robot the command of a golden line; where it is in the API, and its number. None where the
/// server knows as well as the robot that it is no command.
async fn give(
    fixture: &Fixture,
    robot: &mut FakeRobot,
    command: &Value,
    taken: &mut BTreeSet<u64>,
) -> Option<(String, u64)> {
    let mut request = json!({ "command": command["command"] });
    if !command["parameters"].is_null() {
        request["parameters"] = command["parameters"].clone();
    }
    let path = format!("/api/v1/robots/{}/commands", robot.id);
    let answer = fixture.post(&path, &request.to_string()).await;
    if answer.status != 202 {
        answer.is_problem(422, "unknown_behaviour");
        return None;
    }
    let id = answer.json()["id"].as_str().expect("an id").to_owned();
    // Without an answer it comes again.
    let told = loop {
        let told = robot.next_command().await;
        if taken.insert(told.seq) {
            break told;
        }
    };
    assert_eq!(told.action.name(), command["command"]);
    Some((format!("/api/v1/commands/{id}"), told.seq))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_of_the_first_version_is_understood() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("sim-0001").await;
    robot
        .publish("swarm/status/sim-0001", status("sim-0001", true))
        .await;
    fixture.wait_presence("sim-0001", "online").await;
    let view = async || fixture.get("/api/v1/robots/sim-0001").await.json();
    let (mut given, mut taken) = (BTreeMap::new(), BTreeSet::new());
    let mut finished = 0;
    for line in golden() {
        let (topic, payload) = (line["topic"].as_str().expect("a topic"), bytes(&line));
        let content_type = line["content_type"].as_str();
        let body: Value = serde_json::from_slice(&payload).unwrap_or_default();
        let kind = topic.split('/').nth(1).expect("a kind");
        match kind {
            "command" => {
                let new = give(&fixture, &mut robot, &body, &mut taken).await;
                given.extend(new.map(|new| (body["seq"].to_string(), new)));
            }
            "response" => {
                let Some((address, seq)) = given.get(&body["seq"].to_string()) else {
                    continue;
                };
                let mut answer = body.clone();
                answer["seq"] = json!(seq);
                say(&robot, topic, None, answer.to_string().into()).await;
                eventually("the answer is known", async || {
                    let told = fixture.get(address).await.json();
                    told["status"] == body["status"] && told["reason"] == body["reason"]
                })
                .await;
                finished += usize::from(body["status"] != "accepted");
            }
            "time" | "cell" | "pose" => {}
            "telemetry" => {
                let how = TelemetryEncoding::of(content_type).expect("a content type");
                let samples: Result<Vec<_>, _> = how.samples(&payload).collect();
                let samples = samples.expect("samples");
                let newest = samples.last().expect("one or more");
                say(&robot, topic, content_type, payload.clone()).await;
                eventually("the telemetry is known", async || {
                    let told = view().await;
                    told["timestamp"] == newest.timestamp
                        && told["behaviour"] == newest.behaviour.name()
                })
                .await;
            }
            _ => {
                say(&robot, topic, None, payload.clone()).await;
                let field = match kind {
                    "status" => ("boot", &body["boot"]),
                    "heartbeat" => ("uptime_ms", &body["uptime_ms"]),
                    _ => continue,
                };
                eventually(kind, async || view().await[field.0] == *field.1).await;
            }
        }
    }
    assert!(finished >= 20, "{finished} commands came to an end");
    eventually("the parameters are known", async || {
        let told = fixture.get("/api/v1/robots/sim-0001/parameters").await;
        told.status == 200
            && told.json()["parameters"]
                .as_array()
                .is_some_and(|p| p.len() > 5)
    })
    .await;
    let logs = fixture.get("/api/v1/robots/sim-0001/logs").await.json();
    assert!(
        logs["records"]
            .as_array()
            .is_some_and(|records| records.len() >= 5),
        "{logs}"
    );
    let told = view().await;
    assert_eq!(
        (&told["unknown_fields"], &told["unknown_words"]),
        (&json!(0), &json!(0))
    );
    let metrics = fixture.get("/metrics").await;
    for name in ["rejected", "unknown_fields", "unknown_words"] {
        let counted = format!("terracrawler_mqtt_messages_{name}_total{{");
        assert!(!metrics.text().contains(&counted), "{name}");
        let counted = format!("terracrawler_mqtt_{name}_total{{");
        assert!(!metrics.text().contains(&counted), "{name}");
    }
    fixture.stop().await;
}

/// `text` with more fields, on the outside and in its first object.
fn later(text: &str) -> String {
    let mut value: Value = serde_json::from_str(text).expect("JSON");
    value["later"] = json!({ "a": [1, { "b": null }], "c": "text" });
    let inner = value.as_object_mut().and_then(|members| {
        let mut objects = members.iter_mut().filter(|(name, _)| *name != "later");
        objects.find_map(|(_, member)| member.as_object_mut())
    });
    if let Some(inner) = inner {
        inner.insert("later".into(), json!(true));
    }
    value.to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_of_a_later_version_is_understood_as_far_as_that_goes() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("a").await;
    let newer = status("a", true)
        .replace("emulated", "hovering")
        .replace(r#"["drive","range"]"#, r#"["drive","range","dig"]"#)
        .replace("power-on", "cosmic-ray")
        .replace(r#""protocol":1"#, r#""protocol":2"#);
    let view = async || fixture.get("/api/v1/robots/a").await.json();
    say(&robot, "swarm/status/a", None, later(&newer).into()).await;
    fixture.wait_presence("a", "online").await;
    let told = view().await;
    assert_eq!(told["kind"], "hovering");
    assert_eq!(told["capabilities"], json!(["drive", "range", "dig"]));
    assert_eq!(told["boot"]["cause"], "cosmic-ray");
    assert_eq!(told["protocol"], 2);
    assert_eq!(
        (&told["unknown_fields"], &told["unknown_words"]),
        (&json!(2), &json!(3))
    );

    let sample = telemetry("a", 1)
        .replace("IDLE", "CHARGING")
        .replace("MOVING", "CHARGING")
        .replace("wander", "dance");
    robot.publish("swarm/telemetry/a", later(&sample)).await;
    eventually("the state is told as it is", async || {
        let told = view().await;
        told["state"] == "CHARGING" && told["behaviour"] == "dance"
    })
    .await;
    robot
        .publish(
            "swarm/logs/a",
            r#"{"robot":"a","seq":1,"timestamp":5,"level":"fatal","event":"e","text":"t","later":1}"#,
        )
        .await;
    eventually("the record is kept", async || {
        fixture.get("/api/v1/robots/a/logs").await.json()["records"][0]["level"] == "fatal"
    })
    .await;

    // A status that nobody here knows is no end; a reason that nobody knows is told.
    let answer = fixture
        .post("/api/v1/robots/a/commands", r#"{"command":"identify"}"#)
        .await;
    let address = format!(
        "/api/v1/commands/{}",
        answer.json()["id"].as_str().expect("an id")
    );
    let seq = robot.next_command().await.seq;
    for (status, reason, known) in [
        ("deferred", "charging_first", "accepted"),
        ("rejected", "too_hot", "rejected"),
    ] {
        let answer = json!({
            "robot": "a", "seq": seq, "status": status, "reason": reason, "timestamp": 7,
            "later": { "source": "operator:ada" },
        });
        robot
            .publish("swarm/response/robot/a", answer.to_string())
            .await;
        eventually(status, async || {
            let told = fixture.get(&address).await.json();
            told["status"] == known && told["reason"] == reason
        })
        .await;
    }
    // The history and the live feed have no number for such a state; it is an error to them.
    eventually("the sample is kept", async || {
        let told = fixture.get("/api/v1/robots/a/telemetry").await.json();
        told["points"][0]["state"] == "ERROR"
    })
    .await;

    let metrics = fixture.get("/metrics").await;
    for (name, kind, count) in [
        ("fields", "status", 2),
        ("words", "status", 3),
        ("fields", "telemetry", 2),
        ("words", "telemetry", 2),
        ("fields", "logs", 1),
        ("words", "logs", 1),
        ("fields", "response", 2),
        ("words", "response", 3),
    ] {
        let line = format!("terracrawler_mqtt_unknown_{name}_total{{kind=\"{kind}\"}} {count}\n");
        assert!(
            metrics.text().contains(&line),
            "{line}in\n{}",
            metrics.text()
        );
    }
    assert!(
        !metrics
            .text()
            .contains("terracrawler_mqtt_messages_rejected_total{")
    );
    fixture.stop().await;
}
