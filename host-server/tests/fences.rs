//! Fences: put up by requests, watched over robots, and felt by them.

mod support;

use crawler_protocol::Action;
use crawler_server::server::Server;
use futures_util::StreamExt as _;
use hyper::Method;
use serde_json::{Value, json};
use support::{Answer, FakeRobot, Fixture, LIMIT, Scratch, eventually, settings};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;

const FENCES: &str = "/api/v1/fences";
const JSON: [(&str, &str); 1] = [("content-type", "application/json")];

fn square(name: &str, kind: &str, action: &str, middle: [f64; 2], half: f64) -> Value {
    let [x, y] = middle;
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let corners = corners.map(|[dx, dy]| [x + dx * half, y + dy * half]);
    json!({ "name": name, "kind": kind, "action": action, "corners": corners })
}

async fn put_up(fixture: &Fixture, fence: &Value) -> Value {
    let made = fixture.post(FENCES, &fence.to_string()).await;
    assert_eq!(made.status, 201, "{}", made.text());
    made.json()
}

async fn put(fixture: &Fixture, id: &str, body: &str) -> Answer {
    let path = format!("{FENCES}/{id}");
    fixture.call(Method::PUT, &path, &JSON, body).await
}

async fn crossings(fixture: &Fixture, kind: &str, action: &str) -> u64 {
    let name = format!("terracrawler_fence_crossings_total{{kind=\"{kind}\",action=\"{action}\"}}");
    let metrics = fixture.get("/metrics").await;
    let mut lines = metrics.text().lines();
    let value = lines.find_map(|line| line.strip_prefix(&name));
    value
        .expect("there from the start")
        .trim()
        .parse()
        .expect("a number")
}

/// Frames of the live feed, from its snapshot on, until one of that kind passes.
async fn until(fixture: &Fixture, kind: u8, wanted: impl Fn(&Value) -> bool) {
    let address = fixture.server.http();
    let request = format!("ws://{address}/api/v1/live").into_client_request();
    let stream = tokio::net::TcpStream::connect(address)
        .await
        .expect("connect");
    let opened = tokio_tungstenite::client_async(request.expect("request"), stream).await;
    let (mut socket, _) = opened.expect("open");
    let mut last = Value::Null;
    let found = async {
        loop {
            let message = socket.next().await.expect("open").expect("a message");
            if let Message::Binary(frame) = message
                && frame.first() == Some(&kind)
            {
                last = serde_json::from_slice(&frame[1..]).expect("JSON");
                if wanted(&last) {
                    return;
                }
            }
        }
    };
    tokio::time::timeout(LIMIT, found)
        .await
        .unwrap_or_else(|_| {
            panic!("no such frame of kind {kind} within {LIMIT:?}; the last was {last}")
        });
}

/// Waits for the event of a robot, or of nobody in particular.
async fn told(fixture: &Fixture, level: &str, robot: &str, text: &str) {
    until(fixture, 3, |event| {
        event["level"] == level && event["robot"] == robot && event["text"] == text
    })
    .await;
}

/// Stops that a fence has sent to a robot.
async fn stops(fixture: &Fixture, robot: &str) -> Vec<Value> {
    let path = format!("/api/v1/commands?limit=500&robot={robot}");
    let commands = fixture.get(&path).await.json();
    let commands = commands["commands"].as_array().expect("a list").clone();
    let of_fences = |command: &Value| command["source"] == "fence";
    commands.into_iter().filter(of_fences).collect()
}

async fn see(fixture: &Fixture, robot: &str) -> Value {
    fixture.get(&format!("/api/v1/robots/{robot}")).await.json()
}

/// Sends a robot to a place and waits until it is on its way.
async fn send(fixture: &Fixture, robot: &str, [x, y]: [f64; 2]) {
    let path = format!("/api/v1/robots/{robot}/commands");
    let body = json!({ "command": "goto", "parameters": { "x": x, "y": y } }).to_string();
    // One that does not know the time yet refuses.
    eventually("on its way", async || {
        let sent = fixture.post(&path, &body).await;
        assert_eq!(sent.status, 202, "{}", sent.text());
        let id = sent.json()["id"].as_str().expect("an id").to_owned();
        let command = format!("/api/v1/commands/{id}");
        eventually("answered", async || {
            fixture.get(&command).await.json()["status"] != "pending"
        })
        .await;
        let status = fixture.get(&command).await.json()["status"].clone();
        status == "accepted" || status == "completed"
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_leaves_its_fence_is_stopped_once_and_may_come_back() {
    let fixture = Fixture::world(false).await;
    let robot = "sim-0001";
    fixture.wait_told(robot).await;
    eventually("it tells where it is", async || {
        see(&fixture, robot).await["pose"].is_object()
    })
    .await;
    let pose = see(&fixture, robot).await["pose"].clone();
    let home = ["x", "y"].map(|axis| pose[axis].as_f64().expect("a number"));
    let fence = square("yard", "keep_in", "stop", home, 0.4);
    let made = put_up(&fixture, &fence).await;
    assert_eq!(made["by"], "anonymous");
    assert_eq!(see(&fixture, robot).await["fence"], Value::Null);

    // Towards the middle of the world there is room.
    let far = home[0].hypot(home[1]);
    let ahead = if far > 0.5 {
        home.map(|part| -part / far)
    } else {
        [1.0, 0.0]
    };
    send(
        &fixture,
        robot,
        [home[0] + 1.5 * ahead[0], home[1] + 1.5 * ahead[1]],
    )
    .await;
    eventually("beyond the fence", async || {
        see(&fixture, robot).await["fence"] == "yard"
    })
    .await;
    told(&fixture, "warn", robot, "left fence yard").await;
    until(&fixture, 1, |roster| {
        let lines = roster["robots"].as_array().expect("lines");
        lines
            .iter()
            .any(|line| line["id"] == robot && line["fence"] == "yard")
    })
    .await;
    eventually("stopped", async || {
        let stops = stops(&fixture, robot).await;
        stops.len() == 1 && stops[0]["command"] == "stop" && stops[0]["status"] == "completed"
    })
    .await;
    eventually("standing", async || {
        see(&fixture, robot).await["state"] == "IDLE"
    })
    .await;
    // The other robot has been outside all the time.
    eventually("both are counted", async || {
        crossings(&fixture, "keep_in", "stop").await == 2
    })
    .await;
    eventually("written down", async || {
        let audit = fixture.get("/api/v1/audit").await.json();
        let entries = audit["entries"].as_array().expect("entries").clone();
        entries.iter().any(|entry| {
            entry["who"] == "fence"
                && entry["action"] == "command.send"
                && entry["target"] == robot
                && entry["detail"]["fence"] == "yard"
                && entry["detail"]["id"].is_string()
                && entry["outcome"] == "ok"
        })
    })
    .await;

    send(&fixture, robot, home).await;
    eventually("back", async || {
        see(&fixture, robot).await["fence"].is_null()
    })
    .await;
    told(&fixture, "info", robot, "came back into fence yard").await;
    assert_eq!(stops(&fixture, robot).await.len(), 1);
    assert_eq!(crossings(&fixture, "keep_in", "stop").await, 2);
    fixture.stop().await;
}

fn telemetry(robot: &str, seq: u64, x: f64) -> String {
    let there = format!("\"x\":{x}");
    support::telemetry(robot, seq).replace("\"x\":1.5", &there)
}

async fn stand(robot: &FakeRobot, seq: u64, x: f64) {
    let topic = format!("swarm/telemetry/{}", robot.id);
    robot.publish(&topic, telemetry(&robot.id, seq, x)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_fence_says_holds_from_the_next_word_of_a_robot() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    let made = put_up(
        &fixture,
        &square("pit", "keep_out", "warn", [4.0, 0.0], 1.0),
    )
    .await;
    let id = made["id"].as_str().expect("an id");
    let fence = async || see(&fixture, "a").await["fence"].clone();

    stand(&robot, 2, 3.5).await;
    eventually("in the pit", async || fence().await == "pit").await;
    told(&fixture, "warn", "a", "entered fence pit").await;
    // Within the margin it is still there.
    stand(&robot, 3, 2.95).await;
    stand(&robot, 4, 3.05).await;
    stand(&robot, 5, 2.85).await;
    eventually("out of the pit", async || fence().await.is_null()).await;
    told(&fixture, "info", "a", "came out of fence pit").await;
    assert_eq!(crossings(&fixture, "keep_out", "warn").await, 1);
    assert_eq!(stops(&fixture, "a").await, [Value::Null; 0]);

    // Moved over it, and told to stop.
    let wish = square("moat", "keep_out", "stop", [2.0, 0.0], 1.5);
    let changed = put(&fixture, id, &wish.to_string()).await;
    assert_eq!(changed.status, 200, "{}", changed.text());
    let changed = changed.json();
    assert_eq!(changed["made_at"], made["made_at"]);
    assert_eq!(changed["corners"], wish["corners"]);
    assert_eq!(fixture.get(FENCES).await.json()["fences"], json!([changed]));
    stand(&robot, 6, 2.85).await;
    let stop = robot.next_command().await;
    assert_eq!(stop.action, Action::Stop);
    assert_eq!(stop.source.as_str(), "fence");
    for seq in 7..12 {
        stand(&robot, seq, 2.0).await;
    }
    // Taken down, nobody is beyond it.
    assert_eq!(fence().await, "moat");
    let path = format!("{FENCES}/{id}");
    let gone = fixture.call(Method::DELETE, &path, &[], "").await;
    assert_eq!(gone.status, 204);
    assert_eq!(fence().await, Value::Null);
    assert_eq!(stops(&fixture, "a").await.len(), 1);
    assert_eq!(crossings(&fixture, "keep_out", "stop").await, 1);
    let gone = fixture.call(Method::DELETE, &path, &[], "").await;
    gone.is_problem(404, "unknown_fence");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fence_stands_after_a_restart() {
    let scratch = Scratch::new();
    let settings = settings(&scratch, |_| {});
    let server = Server::start(&settings).await.expect("the server starts");
    let fixture = Fixture::of(server, settings.clone());
    let made = put_up(
        &fixture,
        &square("yard", "keep_in", "stop", [0.0, 0.0], 1.0),
    )
    .await;
    fixture.stop().await;

    let server = Server::start(&settings).await.expect("the server starts");
    let fixture = Fixture::of(server, settings);
    assert_eq!(fixture.get(FENCES).await.json()["fences"], json!([made]));
    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    assert_eq!(robot.next_command().await.action, Action::Stop);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_fence_is_refused_and_changes_nothing() {
    let fixture = Fixture::start().await;
    let good = square("yard", "keep_in", "warn", [0.0, 0.0], 1.0);
    let id = put_up(&fixture, &good).await["id"]
        .as_str()
        .expect("an id")
        .to_owned();
    let before = fixture.get(FENCES).await.json();
    let with = |field: &str, value: Value| {
        let mut body = square("other", "keep_out", "stop", [5.0, 0.0], 1.0);
        body[field] = value;
        body.to_string()
    };
    let around = |count: usize| {
        let angle = |n: usize| n as f64 / count as f64 * std::f64::consts::TAU;
        let corners = (0..count).map(|n| json!([angle(n).cos(), angle(n).sin()]));
        Value::Array(corners.collect())
    };
    let long = "x".repeat(33);
    for (body, status, code) in [
        (String::new(), 400, "malformed"),
        ("{".into(), 400, "malformed"),
        ("[]".into(), 422, "invalid_body"),
        ("{}".into(), 422, "invalid_body"),
        (with("name", json!("")), 422, "invalid_fence"),
        (with("name", json!(" yard")), 422, "invalid_fence"),
        (with("name", json!("a\nb")), 422, "invalid_fence"),
        (with("name", json!("a\u{202e}b")), 422, "invalid_fence"),
        (with("name", json!(long)), 422, "invalid_fence"),
        (with("name", json!(7)), 422, "invalid_body"),
        (with("kind", json!("moat")), 422, "invalid_body"),
        (with("action", json!("estop")), 422, "invalid_body"),
        (with("id", json!("0123456789abcdef")), 422, "invalid_body"),
        (with("corners", json!([])), 422, "invalid_fence"),
        (
            with("corners", json!([[0, 0], [1, 0]])),
            422,
            "invalid_fence",
        ),
        (with("corners", around(33)), 422, "invalid_fence"),
        (
            with("corners", json!([[0, 0, 0], [1, 0, 0], [0, 1, 0]])),
            422,
            "invalid_fence",
        ),
        (
            with("corners", json!([[0, 0], [1, null], [0, 1]])),
            422,
            "invalid_body",
        ),
        (
            with("corners", json!([[0, 0], [1e5, 0], [0, 1]])),
            422,
            "invalid_fence",
        ),
        (
            with("corners", json!([[0, 0], [1, 1], [1, 0], [0, 1]])),
            422,
            "invalid_fence",
        ),
        (
            with("corners", json!([[0, 0], [0.1, 0], [0, 0.1]])),
            422,
            "invalid_fence",
        ),
        (
            with("name", json!("x")).replace("6.0", "6e999"),
            400,
            "malformed",
        ),
    ] {
        let posted = fixture.post(FENCES, &body).await;
        assert_eq!(posted.status, status, "{body}: {}", posted.text());
        posted.is_problem(status, code);
        put(&fixture, &id, &body).await.is_problem(status, code);
    }
    let large = " ".repeat(5_000);
    fixture
        .post(FENCES, &large)
        .await
        .is_problem(413, "too_large");
    let other = square("other", "keep_in", "warn", [0.0, 0.0], 1.0).to_string();
    for wrong in ["0", "0123456789abcdef", "%2e%2e", &"f".repeat(500)] {
        put(&fixture, wrong, &other)
            .await
            .is_problem(404, "unknown_fence");
        let path = format!("{FENCES}/{wrong}");
        let gone = fixture.call(Method::DELETE, &path, &[], "").await;
        gone.is_problem(404, "unknown_fence");
    }
    fixture
        .post(FENCES, &good.to_string())
        .await
        .is_problem(409, "exists");
    assert_eq!(fixture.get(FENCES).await.json(), before);

    for n in 1..64 {
        put_up(
            &fixture,
            &square(&format!("no {n}"), "keep_in", "warn", [0.0, 0.0], 1.0),
        )
        .await;
    }
    fixture
        .post(FENCES, &other)
        .await
        .is_problem(409, "too_many");
    put(
        &fixture,
        &id,
        &square("no 3", "keep_in", "warn", [0.0, 0.0], 1.0).to_string(),
    )
    .await
    .is_problem(409, "exists");
    fixture.stop().await;
}
