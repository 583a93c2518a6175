//! A person with `mosquitto_pub` and `mosquitto_sub` against the embedded broker.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crawler_tests::{Terracrawler, publish, subscribe, wait_for};
use serde_json::{Value, json};

const ROBOTS: usize = 5;

fn up() -> Terracrawler {
    let server = Terracrawler::start(&["up", "--robots", "5", "--seed", "7"]);
    server.wait_online(ROBOTS, Duration::from_secs(30));
    // The scenario sets everyone wandering; what follows must not be taken for its answers.
    wait_for("everyone wanders", Duration::from_secs(20), || {
        let wandering = |robot: &Value| robot["behaviour"] == "wander";
        server.online().iter().all(wandering).then_some(())
    });
    std::thread::sleep(Duration::from_millis(500));
    server
}

fn unix_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("a clock after 1970").as_millis() as u64
}

fn command(name: &str, parameters: &Value, seq: u64) -> String {
    json!({"command": name, "parameters": parameters, "timestamp": unix_ms(), "seq": seq,
           "source": "operator:ada"})
    .to_string()
}

/// Sends `payload` to sim-0001 and collects `count` answers to it.
fn ask(server: &Terracrawler, payload: &str, count: usize) -> Vec<Value> {
    let mqtt = server.mqtt();
    std::thread::scope(|scope| {
        let answers =
            scope.spawn(move || subscribe(mqtt, "swarm/response/robot/sim-0001", count, 10));
        std::thread::sleep(Duration::from_millis(400));
        publish(mqtt, "swarm/command/robot/sim-0001", payload);
        let answers = answers.join().expect("mosquitto_sub");
        let parsed = answers
            .iter()
            .map(|(_, payload)| serde_json::from_str(payload).expect("an answer in JSON"));
        parsed.collect()
    })
}

fn outcome(answer: &Value) -> (u64, String, Option<String>) {
    let reason = answer["reason"].as_str().map(str::to_owned);
    (
        answer["seq"].as_u64().expect("a seq"),
        answer["status"].as_str().expect("a status").to_owned(),
        reason,
    )
}

#[test]
fn robots_report_themselves_and_obey() {
    let server = up();

    let statuses = subscribe(server.mqtt(), "swarm/status/+", ROBOTS, 10);
    assert_eq!(
        statuses.len(),
        ROBOTS,
        "every status is retained: {statuses:?}"
    );
    for (topic, payload) in &statuses {
        let status: Value = serde_json::from_str(payload).expect("a status in JSON");
        assert!(topic.ends_with(status["robot"].as_str().expect("an id")));
        assert_eq!(status["online"], true);
        assert_eq!(status["kind"], "simulated");
        assert_eq!(status["protocol"], 1);
    }

    let answers = ask(&server, &command("stop", &Value::Null, 10), 1);
    assert_eq!(outcome(&answers[0]), (10, "completed".into(), None));

    // Turning in place is free whatever stands in front.
    let turn = json!({"direction": "left", "speed": 40, "duration": 500});
    let answers = ask(&server, &command("move", &turn, 11), 2);
    assert_eq!(outcome(&answers[0]), (11, "accepted".into(), None));
    assert_eq!(outcome(&answers[1]), (11, "completed".into(), None));

    // The same again is answered from memory, an older one is stale; neither moves anything.
    let again = ask(&server, &command("move", &turn, 11), 1);
    assert_eq!(again[0]["seq"], 11);
    assert_eq!(again[0]["status"], answers[1]["status"]);
    let older = ask(&server, &command("move", &turn, 9), 1);
    assert_eq!(outcome(&older[0]).1, "stale");
    let telemetry = subscribe(server.mqtt(), "swarm/telemetry/sim-0001", 3, 5);
    for (_, payload) in &telemetry {
        let telemetry: Value = serde_json::from_str(payload).expect("telemetry in JSON");
        assert_eq!(telemetry["state"], "IDLE", "{telemetry}");
        assert_eq!(telemetry["wheels"], json!({"left": 0.0, "right": 0.0}));
    }
    assert_eq!(telemetry.len(), 3);
}

#[test]
fn bad_commands_are_answered_and_nothing_else_suffers() {
    let server = up();
    let late = json!({"command": "move", "timestamp": unix_ms() - 60_000, "seq": 20, "source": "x",
        "parameters": {"direction": "forward", "speed": 40, "duration": 500}});
    let fast = json!({"direction": "forward", "speed": 101, "duration": 500});
    let extra = json!({"direction": "forward", "speed": 10, "duration": 500, "boost": 1});
    let text = json!({"direction": "forward", "speed": "fast", "duration": 500});
    for (payload, status, reason) in [
        (late.to_string(), "expired", None),
        (command("move", &fast, 21), "rejected", Some("out_of_range")),
        (
            command("move", &extra, 22),
            "rejected",
            Some("unknown_field"),
        ),
        (command("move", &text, 23), "rejected", Some("wrong_type")),
        (
            command("fly", &Value::Null, 24),
            "rejected",
            Some("unknown_command"),
        ),
    ] {
        let answers = ask(&server, &payload, 1);
        let (_, got, why) = outcome(&answers[0]);
        assert_eq!(got, status, "{payload}");
        if reason.is_some() {
            assert_eq!(why.as_deref(), reason, "{payload}");
        }
    }

    // What cannot even be read has no answer, and no effect.
    for garbage in ["", "{", "[[[[[[[[", "null", "\u{7f}"] {
        publish(server.mqtt(), "swarm/command/swarm", garbage);
        publish(server.mqtt(), "swarm/telemetry/sim-0002", garbage);
        publish(server.mqtt(), "swarm/status/NOT_AN_ID", "{}");
    }
    let answers = ask(&server, &command("stop", &Value::Null, 30), 1);
    assert_eq!(outcome(&answers[0]), (30, "completed".into(), None));
    assert_eq!(server.online().len(), ROBOTS);
}

#[test]
fn ctrl_c_stops_the_robots_first_and_ends_cleanly() {
    let server = up();
    let mqtt = server.mqtt();
    let statuses = std::thread::spawn(move || subscribe(mqtt, "swarm/telemetry/+", 100_000, 8));
    std::thread::sleep(Duration::from_secs(2));
    let (status, log) = server.interrupt();
    assert!(status.success(), "{status}\n{log}");
    let telemetry = statuses.join().expect("mosquitto_sub");
    let mut last = std::collections::BTreeMap::new();
    for (topic, payload) in telemetry {
        let telemetry: Value = serde_json::from_str(&payload).expect("telemetry in JSON");
        last.insert(topic, telemetry["wheels"].clone());
    }
    assert_eq!(last.len(), ROBOTS, "telemetry of every robot");
    for (topic, wheels) in last {
        assert_eq!(
            wheels,
            json!({"left": 0.0, "right": 0.0}),
            "{topic} at the end"
        );
    }
}
