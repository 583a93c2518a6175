//! A person with `mosquitto_pub` and `mosquitto_sub` against the embedded broker.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crawler_tests::{Subscription, Terracrawler, publish, subscribe, wait_for, wait_for_with};
use serde_json::{Value, json};

const ROBOTS: usize = 5;
/// For everything that has to happen on a busy machine.
const LIMIT: Duration = Duration::from_mins(2);
/// What topics of telemetry begin with.
const TELEMETRY: &str = "swarm/telemetry/";
/// Where one of the robots answers.
const ANSWERS: &str = "swarm/response/robot/sim-0001";

fn up() -> Terracrawler {
    let server = Terracrawler::start(&["up", "--robots", "5", "--seed", "7"]);
    server.wait_online(ROBOTS, LIMIT);
    // The scenario sets everyone wandering.
    let mut online = Vec::new();
    wait_for_with("everyone wanders", LIMIT, &mut online, |online| {
        *online = server.online();
        let wanders = |robot: &Value| robot["behaviour"] == "wander";
        online.iter().all(wanders).then_some(())
    });
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

/// Sends `payload` to sim-0001 and collects `count` answers to its number.
fn ask(server: &Terracrawler, payload: &str, count: usize) -> Vec<Value> {
    let sent: Value = serde_json::from_str(payload).expect("a command in JSON");
    let mut answers = Subscription::start(server.mqtt(), ANSWERS);
    publish(server.mqtt(), "swarm/command/robot/sim-0001", payload);
    let answer = |_| {
        answers.wait(&format!("an answer to {payload}"), |_, text| {
            let answer: Value = serde_json::from_str(text).expect("an answer in JSON");
            (answer["seq"] == sent["seq"]).then_some(answer)
        })
    };
    (0..count).map(answer).collect()
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

    let statuses = subscribe(server.mqtt(), "swarm/status/+", ROBOTS, LIMIT);
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

    // It is done before the wheels are at rest: they run out.
    let mut telemetry = Subscription::start(server.mqtt(), "swarm/telemetry/sim-0001");
    let at_rest = json!({"left": 0.0, "right": 0.0});
    let wheels = |payload: &str| -> Value {
        let telemetry: Value = serde_json::from_str(payload).expect("telemetry in JSON");
        assert_eq!(telemetry["state"], "IDLE", "{telemetry}");
        telemetry["wheels"].clone()
    };
    telemetry.wait("the wheels are at rest", |_, payload| {
        (wheels(payload) == at_rest).then_some(())
    });

    // The same again is answered from memory, an older one is stale; neither moves anything.
    let again = ask(&server, &command("move", &turn, 11), 1);
    assert_eq!(again[0]["seq"], 11);
    assert_eq!(again[0]["status"], answers[1]["status"]);
    let older = ask(&server, &command("move", &turn, 9), 1);
    assert_eq!(outcome(&older[0]).1, "stale");
    let mut telemetry = Subscription::start(server.mqtt(), "swarm/telemetry/sim-0001");
    for _ in 0..3 {
        let (_, payload) = telemetry.next("telemetry");
        assert_eq!(wheels(&payload), at_rest, "{payload}");
    }
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

    // What cannot even be read has no answer, and no effect: what comes after it is answered first.
    let mut answers = Subscription::start(server.mqtt(), ANSWERS);
    for garbage in ["", "{", "[[[[[[[[", "null", "\u{7f}"] {
        publish(server.mqtt(), "swarm/command/swarm", garbage);
        publish(server.mqtt(), "swarm/telemetry/sim-0002", garbage);
        publish(server.mqtt(), "swarm/status/NOT_AN_ID", "{}");
    }
    let stop = command("stop", &Value::Null, 30);
    publish(server.mqtt(), "swarm/command/robot/sim-0001", &stop);
    let (_, answer) = answers.next("an answer to the stop");
    let answer: Value = serde_json::from_str(&answer).expect("an answer in JSON");
    assert_eq!(outcome(&answer), (30, "completed".into(), None));
    assert_eq!(server.online().len(), ROBOTS);
}

#[test]
fn ctrl_c_stops_the_robots_first_and_ends_cleanly() {
    let mut server = up();
    let standing = json!({"left": 0.0, "right": 0.0});
    let wheels = |payload: &str| {
        let telemetry: Value = serde_json::from_str(payload).expect("telemetry in JSON");
        telemetry["wheels"].clone()
    };
    let mut subscription = Subscription::start(server.mqtt(), "swarm/#");
    let mut driving = BTreeSet::new();
    subscription.wait("every robot drives", |topic, payload| {
        if topic.starts_with(TELEMETRY) && wheels(payload) != standing {
            driving.insert(topic.to_owned());
        }
        (driving.len() == ROBOTS).then_some(())
    });
    let status = server.end();
    assert!(status.success(), "{status}\n{}", server.log());
    // Whoever tries to connect anew has read to its end what the server said.
    let listener = TcpListener::bind(("127.0.0.1", server.mqtt())).expect("the server is gone");
    listener.set_nonblocking(true).expect("an option");
    wait_for("mosquitto_sub has read everything", LIMIT, || {
        (listener.accept().is_ok() || subscription.has_ended()).then_some(())
    });
    // Each of them says that it has stopped, and does not drive any more.
    let mut stopped = BTreeSet::new();
    for (topic, payload) in subscription.end() {
        if let Some(robot) = topic.strip_prefix("swarm/response/robot/") {
            let answer: Value = serde_json::from_str(&payload).expect("an answer in JSON");
            assert_eq!(answer["status"], "completed", "{payload}");
            stopped.insert(robot.to_owned());
        } else if let Some(robot) = topic.strip_prefix(TELEMETRY)
            && stopped.contains(robot)
        {
            assert_eq!(wheels(&payload), standing, "{robot} at the end");
        }
    }
    assert_eq!(stopped.len(), ROBOTS, "{stopped:?}");
}
