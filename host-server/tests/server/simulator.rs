//! A simulated world told what to do: by HTTP and by MQTT.

use std::time::Duration;

use crate::support::{Fixture, eventually, mqtt_options, within};
use futures_util::StreamExt as _;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{AsyncClient, Event};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{WebSocketStream, client_async};

#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_a_world_says_so() {
    let fixture = Fixture::start().await;
    let none = fixture.get("/api/v1/simulator").await;
    none.is_problem(404, "no_simulator");
    let none = fixture
        .post("/api/v1/simulator/commands", r#"{"command":"pause"}"#)
        .await;
    none.is_problem(404, "no_simulator");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_world_obeys_requests_and_its_fleet_follows() {
    let fixture = Fixture::world(false).await;
    let tell = async |body: &str| fixture.post("/api/v1/simulator/commands", body).await;
    let state = async || fixture.get("/api/v1/simulator").await.json();
    assert_eq!(state().await["state"], "running");
    assert_eq!(state().await["seed"], 7);
    fixture.wait_presence("sim-0002", "online").await;

    let added = tell(r#"{"command":"add"}"#).await;
    assert_eq!(added.status, 200, "{}", added.text());
    assert_eq!(added.json()["robot"], "sim-0003");
    fixture.wait_presence("sim-0003", "online").await;
    let removed = tell(r#"{"command":"remove","robot":"sim-0002"}"#).await;
    assert_eq!(removed.json()["simulator"]["robots"], 2);
    fixture.wait_presence("sim-0002", "offline").await;

    let paused = tell(r#"{"command":"pause"}"#).await.json();
    assert_eq!(paused["simulator"]["state"], "paused");
    let stepped = tell(r#"{"command":"step","steps":10}"#).await.json();
    let time = |answer: &Value| answer["simulator"]["time"].as_f64().expect("a number");
    assert!(time(&stepped) > time(&paused));
    // It was paused in the middle of a step; from here on steps are whole, and time passes by them
    // alone: where it did by itself as well, these would be longer than 10 ms each.
    let ten = 0.1;
    let mut last = time(&stepped);
    for _ in 0..10 {
        let stepped = tell(r#"{"command":"step","steps":10}"#).await.json();
        let passed = time(&stepped) - last;
        last = time(&stepped);
        assert!((passed - ten).abs() < 1e-6, "{passed} s instead of {ten} s");
        assert_eq!(state().await["time"], stepped["simulator"]["time"]);
    }
    let stepped = state().await;
    tell(r#"{"command":"speed","factor":2}"#).await;
    assert_eq!(state().await["factor"], 2.0);
    tell(r#"{"command":"resume"}"#).await;
    eventually("time to pass", async || {
        state().await["time"].as_f64() > stepped["time"].as_f64()
    })
    .await;
    let reset = tell(r#"{"command":"reset","seed":9}"#).await.json();
    assert_eq!(reset["simulator"]["seed"], 9);
    fixture.wait_presence("sim-0002", "online").await;

    for (body, status, code) in [
        ("{", 400, "malformed"),
        (r#"{"command":"fly"}"#, 422, "invalid_command"),
        (r#"{"command":"step","steps":0}"#, 422, "invalid_command"),
        (
            r#"{"command":"remove","robot":"sim-0099"}"#,
            404,
            "unknown_robot",
        ),
        (r#"{"command":"restore","name":"here"}"#, 409, "refused"),
        (r#"{"command":"forget","name":"here"}"#, 409, "refused"),
        (r#"{"command":"load","scenario":"nowhere"}"#, 409, "refused"),
        (
            r#"{"command":"load","scenario":"corridor","robots":0}"#,
            422,
            "invalid_command",
        ),
        (r#"{"command":"take","item":1}"#, 409, "refused"),
        (r#"{"command":"drop"}"#, 422, "invalid_command"),
        (
            r#"{"command":"drop","obstacle":{"shape":"circle","x":9,"y":0,"r":0.1}}"#,
            409,
            "refused",
        ),
        (
            r#"{"command":"drop","obstacle":{"shape":"circle","x":0,"y":0,"r":1e39}}"#,
            422,
            "invalid_command",
        ),
        (
            r#"{"command":"add","pose":{"x":999,"y":0,"theta":0}}"#,
            409,
            "refused",
        ),
    ] {
        tell(body).await.is_problem(status, code);
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_world_obeys_messages_and_answers_them() {
    /// After so long without an answer it is said again.
    const AGAIN: Duration = Duration::from_secs(1);
    let fixture = Fixture::world(false).await;
    let mqtt = fixture.server.mqtt();
    let options = mqtt_options("somebody", mqtt.port);
    let (client, mut events) = AsyncClient::new(options, 16);
    let fleet = fixture.settings.fleet.as_str().to_owned();
    let answers = format!("{fleet}/simulator/response");
    client
        .subscribe(answers, QoS::AtLeastOnce)
        .await
        .expect("room");
    let subscribed = async {
        while !matches!(
            events.poll().await.expect("a connection"),
            Event::Incoming(Packet::SubAck(_))
        ) {}
    };
    within("a subscription", subscribed).await;
    let mut next = async |payload: &'static str, command: Value| -> Value {
        let topic = format!("{fleet}/simulator/command");
        let answer = async {
            // The world's own session may take a moment to stand: until then nobody answers. Answers
            // to what was said before are passed over, since they come again where it was said again.
            loop {
                let sent = client.publish(topic.clone(), QoS::AtLeastOnce, false, payload);
                sent.await.expect("room");
                let answer = async {
                    loop {
                        let event = events.poll().await.expect("a connection");
                        if let Event::Incoming(Packet::Publish(publish)) = event {
                            let answer: Value =
                                serde_json::from_slice(&publish.payload).expect("JSON");
                            if answer["command"] == command {
                                return answer;
                            }
                        }
                    }
                };
                if let Ok(answer) = tokio::time::timeout(AGAIN, answer).await {
                    return answer;
                }
            }
        };
        within(payload, answer).await
    };
    let paused = next(r#"{"command":"pause"}"#, json!("pause")).await;
    assert_eq!(paused["command"], "pause");
    assert_eq!(paused["status"], "completed");
    assert_eq!(paused["simulator"]["state"], "paused");
    let refused = next(r#"{"command":"restore","name":"here"}"#, json!("restore")).await;
    assert_eq!(refused["status"], "rejected");
    assert_eq!(refused["code"], "refused");
    let dropped = next(
        r#"{"command":"drop","object":{"shape":"cone","x":-2.9,"y":-2.9,"size":0.1,"colour":"red"}}"#,
        json!("drop"),
    )
    .await;
    assert!(dropped["item"].is_u64(), "{dropped}");
    assert_eq!(dropped["simulator"]["scenario"], "empty");
    assert!(dropped["simulator"].get("dropped").is_none(), "{dropped}");
    let nonsense = next("nonsense", Value::Null).await;
    assert_eq!(nonsense["code"], "invalid_command");
    assert_eq!(nonsense["command"], json!(null));
    fixture.stop().await;
}

/// The next hello of the live feed.
async fn hello(socket: &mut WebSocketStream<TcpStream>) -> Value {
    let next = async {
        loop {
            let message = socket.next().await.expect("open").expect("a message");
            if let Message::Binary(frame) = message
                && frame.first() == Some(&0)
            {
                return serde_json::from_slice(&frame[1..]).expect("JSON");
            }
        }
    };
    within("another arena is told", next).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_world_is_furnished_kept_left_and_found_again() {
    let fixture = Fixture::world(false).await;
    let tell = async |body: &str| {
        let answer = fixture.post("/api/v1/simulator/commands", body).await;
        assert_eq!(answer.status, 200, "{body}: {}", answer.text());
        answer.json()
    };
    let address = fixture.server.http();
    let request = format!("ws://{address}/api/v1/live");
    let stream = TcpStream::connect(address).await.expect("connect");
    let (mut socket, _) = client_async(request, stream).await.expect("a reader");
    assert_eq!(hello(&mut socket).await["arena"]["obstacles"], json!([]));
    fixture.wait_presence("sim-0002", "online").await;

    let block = json!({"shape": "box", "x": -2.5, "y": 2.5, "w": 0.5, "h": 0.25, "theta": 0.0});
    let cone = json!({"shape": "cone", "x": 2.5, "y": 2.5, "size": 0.25, "colour": "purple"});
    let command = json!({"command": "drop", "obstacle": block});
    let first = tell(&command.to_string()).await;
    let item = first["item"].as_u64().expect("a number");
    assert_eq!(
        hello(&mut socket).await["arena"]["obstacles"],
        json!([block])
    );
    let command = json!({"command": "drop", "object": cone});
    let second = tell(&command.to_string()).await;
    assert_eq!(hello(&mut socket).await["arena"]["objects"], json!([cone]));
    let other = second["item"].as_u64().expect("a number");
    let lying = json!([{"id": item, "obstacle": block}, {"id": other, "object": cone}]);
    assert_eq!(second["simulator"]["dropped"], lying);

    tell(r#"{"command":"pause"}"#).await;
    let kept = tell(r#"{"command":"snapshot","name":"furnished"}"#).await;
    let marks = kept["simulator"]["bookmarks"].as_array().expect("a list");
    assert_eq!(marks.len(), 1);
    assert_eq!(marks[0]["name"], "furnished");
    assert_eq!(marks[0]["scenario"], "empty");
    assert_eq!(marks[0]["robots"], 2);
    assert_eq!(marks[0]["time"], kept["simulator"]["time"]);
    assert!(marks[0]["made_at"].as_u64() > Some(1_700_000_000_000));

    let left = tell(r#"{"command":"load","scenario":"corridor","robots":3}"#).await;
    let world = &left["simulator"];
    assert_eq!(
        (&world["scenario"], &world["robots"]),
        (&json!("corridor"), &json!(3))
    );
    assert_eq!(world["dropped"], json!([]));
    let arena = hello(&mut socket).await;
    assert_eq!(arena["arena"]["width"], 8.0);
    assert_eq!(
        arena["arena"]["obstacles"].as_array().map(Vec::len),
        Some(2)
    );
    tell(r#"{"command":"resume"}"#).await;
    fixture.wait_presence("sim-0003", "online").await;

    let back = tell(r#"{"command":"restore","name":"furnished"}"#).await;
    let world = &back["simulator"];
    assert_eq!(world["dropped"], lying);
    assert_eq!(
        (&world["scenario"], &world["robots"]),
        (&json!("empty"), &json!(2))
    );
    assert!(world["time"].as_f64() >= kept["simulator"]["time"].as_f64());
    let arena = hello(&mut socket).await;
    assert_eq!(arena["arena"]["obstacles"], json!([block]));
    assert_eq!(arena["arena"]["objects"], json!([cone]));
    fixture.wait_presence("sim-0003", "offline").await;
    fixture.wait_presence("sim-0002", "online").await;

    let body = json!({"command": "take", "item": item}).to_string();
    let taken = tell(&body).await;
    assert_eq!(
        taken["simulator"]["dropped"],
        json!([{"id": other, "object": cone}])
    );
    assert_eq!(hello(&mut socket).await["arena"]["obstacles"], json!([]));
    let forgotten = tell(r#"{"command":"forget","name":"furnished"}"#).await;
    assert_eq!(forgotten["simulator"]["bookmarks"], json!([]));
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn scenarios_are_listed_and_shown_without_a_world() {
    let fixture = Fixture::start().await;
    let list = fixture.get("/api/v1/simulator/scenarios").await.json();
    let list = list["scenarios"].as_array().expect("a list");
    let named = |name: &str| list.iter().find(|one| one["name"] == name).expect("there");
    assert_eq!(list[0]["name"], "arena");
    assert!(
        list.iter()
            .all(|one| one["about"].as_str().is_some_and(|text| text.len() > 20))
    );
    let corridor = named("corridor");
    assert_eq!(
        (&corridor["width"], &corridor["obstacles"]),
        (&json!(8.0), &json!(2))
    );
    assert_eq!(named("search")["objects"], 1);
    assert_eq!(named("dynamic-environment")["movers"], 3);

    let path = "/api/v1/simulator/scenarios/corridor";
    let shown = fixture.get(&format!("{path}?seed=5&robots=3")).await.json();
    assert_eq!(
        (&shown["name"], &shown["seed"]),
        (&json!("corridor"), &json!(5))
    );
    assert_eq!(
        (&shown["robots"], &shown["about"]),
        (&json!(3), &corridor["about"])
    );
    assert_eq!(
        shown["arena"]["obstacles"].as_array().map(Vec::len),
        Some(2)
    );
    let poses = shown["poses"].as_array().expect("poses");
    assert_eq!(poses.len(), 3);
    for pose in poses {
        for (axis, most) in [("x", 4.0), ("y", 0.8), ("theta", 3.2)] {
            assert!(
                pose[axis].as_f64().is_some_and(|value| value.abs() < most),
                "{pose}"
            );
        }
    }
    let many = fixture
        .get("/api/v1/simulator/scenarios/arena?robots=1200")
        .await
        .json();
    assert_eq!(many["robots"], 1_200);
    assert_eq!(many["poses"].as_array().map(Vec::len), Some(1_000));
    for (path, status, code) in [
        (
            "/api/v1/simulator/scenarios/nowhere",
            404,
            "unknown_scenario",
        ),
        (
            "/api/v1/simulator/scenarios/..%2Farena",
            404,
            "unknown_scenario",
        ),
        (
            "/api/v1/simulator/scenarios/arena?robots=0",
            400,
            "bad_query",
        ),
        (
            "/api/v1/simulator/scenarios/arena?robots=65536",
            400,
            "bad_query",
        ),
        (
            "/api/v1/simulator/scenarios/arena?seed=-1",
            400,
            "bad_query",
        ),
        ("/api/v1/simulator/scenarios/arena?size=1", 400, "bad_query"),
        (
            "/api/v1/simulator/scenarios/corridor?robots=2000",
            409,
            "refused",
        ),
    ] {
        fixture.get(path).await.is_problem(status, code);
    }
    fixture.stop().await;
}
