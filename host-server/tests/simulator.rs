//! A simulated world told what to do: by HTTP and by MQTT.

mod support;

use std::time::Duration;

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{AsyncClient, Event, MqttOptions};
use serde_json::{Value, json};
use support::{Fixture, eventually};

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
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!(state().await["time"], stepped["simulator"]["time"]);
    tell(r#"{"command":"speed","factor":2}"#).await;
    assert_eq!(state().await["factor"], 2.0);
    tell(r#"{"command":"resume"}"#).await;
    eventually("time to pass", async || {
        state().await["time"].as_f64() > stepped["simulator"]["time"].as_f64()
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
        (r#"{"command":"snapshot","name":"here"}"#, 409, "refused"),
        (r#"{"command":"restore","name":"here"}"#, 409, "refused"),
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
    let fixture = Fixture::world(false).await;
    let mqtt = fixture.server.mqtt();
    let mut options = MqttOptions::new("somebody", &mqtt.host, mqtt.port);
    options.set_keep_alive(Duration::from_secs(5));
    let (client, mut events) = AsyncClient::new(options, 16);
    let fleet = fixture.settings.fleet.as_str().to_owned();
    let answers = format!("{fleet}/simulator/response");
    client
        .subscribe(answers, QoS::AtLeastOnce)
        .await
        .expect("room");
    let mut next = async |payload: &'static str| -> Value {
        let topic = format!("{fleet}/simulator/command");
        // The world's own session may take a moment to stand; an answer says that it does.
        for _ in 0..40 {
            let sent = client.publish(topic.clone(), QoS::AtLeastOnce, false, payload);
            sent.await.expect("room");
            let answer = async {
                loop {
                    if let Event::Incoming(Packet::Publish(publish)) =
                        events.poll().await.expect("a connection")
                    {
                        return serde_json::from_slice(&publish.payload).expect("JSON");
                    }
                }
            };
            if let Ok(answer) = tokio::time::timeout(Duration::from_millis(500), answer).await {
                return answer;
            }
        }
        panic!("nobody answers {payload}");
    };
    let paused = next(r#"{"command":"pause"}"#).await;
    assert_eq!(paused["command"], "pause");
    assert_eq!(paused["status"], "completed");
    assert_eq!(paused["simulator"]["state"], "paused");
    let refused = next(r#"{"command":"restore","name":"here"}"#).await;
    assert_eq!(refused["status"], "rejected");
    assert_eq!(refused["code"], "refused");
    let nonsense = next("nonsense").await;
    assert_eq!(nonsense["code"], "invalid_command");
    assert_eq!(nonsense["command"], json!(null));
    fixture.stop().await;
}
