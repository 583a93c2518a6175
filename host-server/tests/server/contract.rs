//! Every call of the contract, with what goes wrong, against a robot made of an MQTT client.

use crate::support;
use crate::support::{Fixture, eventually};
use crawler_protocol::{Action, Reason, ResponseStatus};
use hyper::Method;
use serde_json::json;

#[tokio::test(flavor = "multi_thread")]
async fn robots_are_told_as_they_are() {
    let fixture = Fixture::start().await;
    assert_eq!(
        fixture.get("/api/v1/robots").await.json()["robots"],
        json!([])
    );
    fixture
        .get("/api/v1/robots/ada-1")
        .await
        .is_problem(404, "unknown_robot");
    fixture
        .get("/api/v1/robots/NO")
        .await
        .is_problem(404, "unknown_robot");
    fixture
        .get("/api/v1/robots/%ff")
        .await
        .is_problem(400, "bad_request");

    let robot = fixture.robot("ada-1").await;
    robot.introduce().await;
    fixture.wait_presence("ada-1", "online").await;
    eventually("telemetry", async || {
        fixture.get("/api/v1/robots/ada-1").await.json()["behaviour"] == "wander"
    })
    .await;
    let seen = fixture.get("/api/v1/robots/ada-1").await.json();
    for (key, value) in [
        ("id", json!("ada-1")),
        ("kind", json!("emulated")),
        ("board", json!("fake")),
        ("capabilities", json!(["drive", "range"])),
        ("boot", json!({"count": 3, "cause": "power-on"})),
        ("state", json!("MOVING")),
        ("range_mm", json!(812)),
        ("temperature_c", json!(22.5)),
        ("battery", json!({"mv": 7610, "percent": 71})),
        ("rssi_dbm", json!(-61)),
        ("duplicate", json!(false)),
    ] {
        assert_eq!(seen[key], value, "{key}");
    }
    assert_eq!(
        fixture.get("/api/v1/robots").await.json()["robots"][0],
        seen
    );

    robot.vanish().await;
    fixture.wait_presence("ada-1", "offline").await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_goes_out_and_its_answers_come_back() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("ada-1").await;
    robot.introduce().await;
    fixture.wait_presence("ada-1", "online").await;

    let body =
        r#"{"command":"move","parameters":{"direction":"forward","speed":80,"duration":2000}}"#;
    let sent = fixture.post("/api/v1/robots/ada-1/commands", body).await;
    assert_eq!(sent.status, 202, "{}", sent.text());
    let address = sent.header("location").to_owned();
    assert_eq!(
        address,
        format!(
            "/api/v1/commands/{}",
            sent.json()["id"].as_str().expect("id")
        )
    );
    assert_eq!(sent.json()["status"], "pending");

    let command = robot.next_command().await;
    assert_eq!(sent.json()["seq"], command.seq);
    assert!(matches!(
        command.action,
        Action::Move {
            speed: 80,
            duration_ms: 2_000,
            ..
        }
    ));

    robot
        .answer(command.seq, ResponseStatus::Accepted, None)
        .await;
    eventually("accepted", async || {
        fixture.get(&address).await.json()["status"] == "accepted"
    })
    .await;
    robot
        .answer(command.seq, ResponseStatus::Failed, Some(Reason::Blocked))
        .await;
    eventually("failed", async || {
        fixture.get(&address).await.json()["status"] == "failed"
    })
    .await;
    let record = fixture.get(&address).await.json();
    assert_eq!(record["reason"], "blocked");
    assert_eq!(record["counts"]["failed"], 1);
    assert_eq!(record["outcomes"][0]["robot"], "ada-1");

    let stop = fixture
        .post("/api/v1/robots/ada-1/commands", r#"{"command":"stop"}"#)
        .await;
    newest_first(&fixture).await;
    let command = robot.next_command().await;
    assert!(
        stop.json()["seq"].as_u64() > record["seq"].as_u64(),
        "numbers rise"
    );
    robot
        .answer(command.seq, ResponseStatus::Completed, None)
        .await;
    eventually("latency", async || {
        let metrics = fixture.get("/metrics").await;
        metrics
            .text()
            .contains(r#"terracrawler_command_latency_seconds_count{command="stop"} 1"#)
    })
    .await;

    fixture
        .get("/api/v1/commands/1")
        .await
        .is_problem(404, "unknown_command_id");
    fixture
        .get("/api/v1/commands/x")
        .await
        .is_problem(404, "unknown_command_id");
    fixture.stop().await;
}

/// A move and a stop were sent to one robot.
async fn newest_first(fixture: &Fixture) {
    let ask = async |query: &str| {
        let answer = fixture.get(&format!("/api/v1/commands{query}")).await;
        answer.json()["commands"]
            .as_array()
            .expect("a list")
            .clone()
    };
    let names = |list: &[serde_json::Value]| -> Vec<String> {
        let names = list.iter().map(|one| one["command"].as_str());
        names.map(|name| name.expect("a name").to_owned()).collect()
    };
    let all = ask("").await;
    assert_eq!(names(&all), ["stop", "move"]);
    assert_eq!(all[1]["outcomes"], serde_json::json!([]));
    assert_eq!(all[1]["counts"]["failed"], 1);
    let one = ask("?robot=ada-1&limit=1").await;
    assert_eq!(names(&one), ["stop"]);
    assert_eq!(one[0]["outcomes"][0]["robot"], "ada-1");
    assert_eq!(
        ask("?robot=somebody-else").await,
        [] as [serde_json::Value; 0]
    );

    let drive = r#"{"command":"drive","parameters":{"v":0.1,"w":0.0}}"#;
    let address = "/api/v1/robots/ada-1/commands";
    assert_eq!(fixture.post(address, drive).await.status, 202);
    assert_eq!(
        names(&ask("").await),
        ["stop", "move"],
        "steering is left out"
    );
    assert_eq!(names(&ask("?drive=true").await), ["drive", "stop", "move"]);
    for (query, status, code) in [
        ("robot=no%20name", 404, "unknown_robot"),
        ("limit=-1", 400, "bad_query"),
        ("colour=red", 400, "bad_query"),
    ] {
        let answer = fixture.get(&format!("/api/v1/commands?{query}")).await;
        answer.is_problem(status, code);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_command_counts_every_robot() {
    let fixture = Fixture::start().await;
    let none = fixture
        .post("/api/v1/swarm/commands", r#"{"command":"scan"}"#)
        .await;
    none.is_problem(409, "no_robots");
    let stop = fixture
        .post("/api/v1/swarm/commands", r#"{"command":"stop"}"#)
        .await;
    assert_eq!(
        stop.status, 202,
        "a stop goes out whatever the server knows"
    );

    let mut a = fixture.robot("a").await;
    let mut b = fixture.robot("b").await;
    for robot in [&a, &b] {
        robot.introduce().await;
        fixture.wait_presence(&robot.id, "online").await;
    }
    let sent = fixture
        .post("/api/v1/swarm/commands", r#"{"command":"stop"}"#)
        .await;
    assert_eq!(sent.json()["counts"]["pending"], 2);
    let address = sent.header("location").to_owned();
    for robot in [&mut a, &mut b] {
        let seq = robot.next_command().await.seq;
        robot.answer(seq, ResponseStatus::Completed, None).await;
    }
    eventually("completed", async || {
        fixture.get(&address).await.json()["status"] == "completed"
    })
    .await;
    // The stop that went out to nobody is told of as well.
    let told = loop {
        let told = a.next("response/swarm").await;
        let told: serde_json::Value = serde_json::from_slice(&told.payload).expect("JSON");
        if told["seq"] == sent.json()["seq"] {
            break told;
        }
    };
    assert_eq!(told["command"], "stop");
    assert_eq!(told["outcomes"]["completed"], 2);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_offline_robot_gets_stops_and_never_late_motion() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    robot
        .publish("swarm/status/a", support::status("a", false))
        .await;
    fixture.wait_presence("a", "offline").await;
    let drive = r#"{"command":"drive","parameters":{"v":0.1,"w":0.0}}"#;
    let held = fixture.post("/api/v1/robots/a/commands", drive).await;
    assert_eq!(held.status, 202);
    let held = held.header("location").to_owned();
    for halt in ["stop", "estop"] {
        let body = format!(r#"{{"command":"{halt}"}}"#);
        assert_eq!(
            fixture
                .post("/api/v1/robots/a/commands", &body)
                .await
                .status,
            202
        );
    }
    let unknown = fixture
        .post("/api/v1/robots/b/commands", r#"{"command":"stop"}"#)
        .await;
    unknown.is_problem(404, "unknown_robot");
    eventually("expired", async || {
        fixture.get(&held).await.json()["status"] == "expired"
    })
    .await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_command_never_leaves_the_server() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    let large = format!(r#"{{"command":"stop","pad":"{}"}}"#, "x".repeat(5_000));
    for (body, status, code) in [
        ("", 400, "malformed"),
        ("{", 400, "malformed"),
        ("[]", 422, "wrong_type"),
        (r#"{"command":"stop"} x"#, 400, "malformed"),
        (r#"{"command":"dance"}"#, 422, "unknown_command"),
        (r#"{"parameters":{}}"#, 422, "missing_field"),
        (r#"{"command":"stop","seq":1}"#, 422, "unknown_field"),
        (
            r#"{"command":"stop","command":"stop"}"#,
            422,
            "duplicate_field",
        ),
        (r#"{"command":7}"#, 422, "wrong_type"),
        (
            r#"{"command":"drive","parameters":{"v":"x","w":0}}"#,
            422,
            "wrong_type",
        ),
        (
            r#"{"command":"move","parameters":{"direction":"forward","speed":101,"duration":1}}"#,
            422,
            "out_of_range",
        ),
        (
            r#"{"command":"behave","parameters":{"behaviour":"sleep"}}"#,
            422,
            "unknown_behaviour",
        ),
        (large.as_str(), 413, "too_large"),
    ] {
        for path in ["/api/v1/robots/a/commands", "/api/v1/swarm/commands"] {
            fixture.post(path, body).await.is_problem(status, code);
        }
    }
    let path = "/api/v1/robots/a/commands";
    let no_type = fixture
        .call(Method::POST, path, &[], r#"{"command":"stop"}"#)
        .await;
    no_type.is_problem(415, "unsupported_media_type");
    let form = [("content-type", "text/plain")];
    let text = fixture
        .call(Method::POST, path, &form, r#"{"command":"stop"}"#)
        .await;
    text.is_problem(415, "unsupported_media_type");

    // The first thing the robot hears is the first thing that was right.
    fixture.post(path, r#"{"command":"identify"}"#).await;
    assert_eq!(robot.next_command().await.action, Action::Identify);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn parameters_are_read_and_set() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    let path = "/api/v1/robots/a/parameters";
    fixture.get(path).await.is_problem(404, "no_parameters");
    let message = r#"{"robot":"a","values":{"safe_distance_mm":{"value":600,"default":500,"min":100,"max":2000,"unit":"mm"}}}"#;
    robot.publish("swarm/parameters/a", message).await;
    eventually("parameters", async || fixture.get(path).await.status == 200).await;
    assert_eq!(
        fixture.get(path).await.json(),
        json!({"parameters": [{"name": "safe_distance_mm", "value": 600.0, "default": 500.0,
            "min": 100.0, "max": 2000.0, "unit": "mm"}]})
    );

    let json_type = [("content-type", "application/json")];
    let put = async |body: &str| fixture.call(Method::PUT, path, &json_type, body).await;
    let sent = put(r#"{"safe_distance_mm":700}"#).await;
    assert_eq!(sent.status, 202, "{}", sent.text());
    assert_eq!(sent.json()["command"], "set");
    let command = robot.next_command().await;
    assert!(matches!(&command.action, Action::Set(values) if values.len() == 1));

    put("7").await.is_problem(422, "wrong_type");
    put("").await.is_problem(400, "malformed");
    // No way out of the place the body is put in.
    put(r#"{"a":1},"command":"estop""#)
        .await
        .is_problem(422, "duplicate_field");
    assert!(put(r#"{"a":1}}{"#).await.status.is_client_error());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn logs_are_told_newest_first() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    for seq in 0..5 {
        let record = format!(
            r#"{{"robot":"a","seq":{seq},"timestamp":1,"level":"info","event":"e","text":"line {seq}"}}"#
        );
        robot.publish("swarm/logs/a", record).await;
    }
    eventually("five records", async || {
        let logs = fixture.get("/api/v1/robots/a/logs").await;
        logs.status == 200 && logs.json()["records"].as_array().map(Vec::len) == Some(5)
    })
    .await;
    let two = fixture.get("/api/v1/robots/a/logs?limit=2").await.json();
    assert_eq!(two["records"][0]["seq"], 4);
    assert_eq!(two["records"].as_array().map(Vec::len), Some(2));
    fixture
        .get("/api/v1/robots/a/logs?limit=x")
        .await
        .is_problem(400, "bad_query");
    fixture
        .get("/api/v1/robots/a/logs?since=1")
        .await
        .is_problem(400, "bad_query");
    fixture
        .get("/api/v1/robots/b/logs")
        .await
        .is_problem(404, "unknown_robot");
    fixture.stop().await;
}
