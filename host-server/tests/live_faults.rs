//! Simulated robots of a running world, broken and mended over HTTP.

mod support;

use std::time::{Duration, Instant};

use hyper::Method;
use rumqttc::v5::mqttbytes::QoS;
use serde_json::Value;
use support::{Answer, Fixture, eventually};

/// A world of two robots that are online, over a radio or without one.
async fn world(radio: bool) -> Fixture {
    let fixture = Fixture::world(radio).await;
    for robot in ["sim-0001", "sim-0002"] {
        fixture.wait_presence(robot, "online").await;
    }
    fixture
}

async fn inject(fixture: &Fixture, robot: &str, body: &str) -> Answer {
    let path = format!("/api/v1/robots/{robot}/faults");
    fixture.post(&path, body).await
}

async fn heal(fixture: &Fixture, robot: &str) {
    let path = format!("/api/v1/robots/{robot}/faults");
    let healed = fixture.call(Method::DELETE, &path, &[], "").await;
    assert_eq!(healed.status, 202, "{}", healed.text());
}

async fn view(fixture: &Fixture, robot: &str) -> Value {
    fixture.get(&format!("/api/v1/robots/{robot}")).await.json()
}

/// Waits for a robot to be like this.
async fn wait(fixture: &Fixture, robot: &str, key: &str, value: &str) {
    let what = format!("{robot}: {key} {value}");
    eventually(&what, async || view(fixture, robot).await[key] == value).await;
}

/// Waits for a line in the log of a robot. It stays there, whereas a state may be over before
/// anybody looks.
async fn wait_logged(fixture: &Fixture, robot: &str, words: &str) {
    let what = format!("{words} is in the log of {robot}");
    let path = format!("/api/v1/robots/{robot}/logs");
    eventually(&what, async || {
        fixture.get(&path).await.text().contains(words)
    })
    .await;
}

/// Waits until an event of this text about the robot is written down.
async fn wait_told(fixture: &Fixture, robot: &str, text: &str) {
    let what = format!("{robot} {text} is told");
    let path = format!("/api/v1/events?robot={robot}");
    eventually(&what, async || {
        let told = fixture.get(&path).await.json();
        let events = told["events"].as_array().expect("a list");
        events.iter().any(|event| event["text"] == text)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_ranger_is_dead_says_so_and_recovers() {
    let fixture = world(false).await;
    wait(&fixture, "sim-0001", "state", "IDLE").await;
    let done = inject(&fixture, "sim-0001", r#"{"fault":{"fault":"ranger-dead"}}"#).await;
    assert_eq!(done.status, 202, "{}", done.text());
    wait(&fixture, "sim-0001", "state", "ERROR").await;
    wait_logged(&fixture, "sim-0001", "ranger").await;
    wait(&fixture, "sim-0002", "state", "IDLE").await;
    heal(&fixture, "sim-0001").await;
    wait(&fixture, "sim-0001", "state", "IDLE").await;

    let brief = r#"{"fault":{"fault":"ranger-dead"},"lasting_ms":1500}"#;
    assert_eq!(inject(&fixture, "sim-0002", brief).await.status, 202);
    wait_logged(&fixture, "sim-0002", "ranger is over").await;
    wait(&fixture, "sim-0002", "state", "IDLE").await;

    inject(&fixture, "sim-0099", brief)
        .await
        .is_problem(404, "unknown_robot");
    inject(&fixture, "sim-0002", r#"{"fault":{"fault":"rust"}}"#)
        .await
        .is_problem(422, "out_of_range");
    fixture.stop().await;
}

/// A robot loses its link, is offline, takes no offence at what is said meanwhile, and is back.
async fn link_is_lost_and_found(radio: bool) {
    let fixture = world(radio).await;
    let begun = Instant::now();
    let cut = r#"{"fault":{"fault":"link-loss","how":"silent"}}"#;
    let cut = inject(&fixture, "sim-0001", cut).await;
    assert_eq!(cut.status, 202, "{}", cut.text());
    wait(&fixture, "sim-0001", "presence", "offline").await;
    // The broker has to find out by itself: nobody closed a connection.
    let silence = begun.elapsed();
    assert!(silence > Duration::from_secs(3), "{silence:?}");
    wait(&fixture, "sim-0002", "presence", "online").await;
    heal(&fixture, "sim-0001").await;
    wait(&fixture, "sim-0001", "presence", "online").await;
    wait_logged(&fixture, "sim-0001", "link").await;

    let brief = r#"{"fault":{"fault":"link-loss","how":"radio"},"lasting_ms":12000}"#;
    assert_eq!(inject(&fixture, "sim-0002", brief).await.status, 202);
    wait_told(&fixture, "sim-0002", "offline").await;
    wait(&fixture, "sim-0002", "presence", "online").await;

    // A world that begins again has whole links, whatever the last one ended with.
    let cut = r#"{"fault":{"fault":"link-loss","how":"radio"}}"#;
    assert_eq!(inject(&fixture, "sim-0001", cut).await.status, 202);
    wait(&fixture, "sim-0001", "presence", "offline").await;
    let path = "/api/v1/simulator/commands";
    let reset = fixture.post(path, r#"{"command":"reset"}"#).await;
    assert_eq!(reset.status, 200, "{}", reset.text());
    wait(&fixture, "sim-0001", "presence", "online").await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_link_is_found_again() {
    Box::pin(link_is_lost_and_found(false)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_link_lost_in_a_radio_is_found_again() {
    Box::pin(link_is_lost_and_found(true)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn faults_by_message_are_obeyed_and_those_of_other_robots_are_not_answered() {
    let fixture = world(false).await;
    let mut ear = fixture.robot("ada-1").await;
    let listen = ear
        .client
        .subscribe("swarm/simulator/response", QoS::AtLeastOnce);
    listen.await.expect("room");
    let tell = async |payload: &str| ear.publish("swarm/simulator/command", payload).await;
    // The world's own session may take a moment to stand; a state says that it does.
    let dead = r#"{"command":"inject","robot":"sim-0001","fault":{"fault":"ranger-dead"}}"#;
    eventually("the fault arrives", async || {
        tell(dead).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        view(&fixture, "sim-0001").await["state"] == "ERROR"
    })
    .await;
    // For a robot on a bench, and then one for this world: only the second is answered.
    tell(&dead.replace("sim-0001", "bench-1")).await;
    tell(r#"{"command":"heal","robot":"sim-0001"}"#).await;
    loop {
        let answer = ear.next("simulator/response").await;
        let answer: Value = serde_json::from_slice(&answer.payload).expect("JSON");
        assert_eq!(answer["status"], "completed", "{answer}");
        if answer["command"] == "heal" {
            break;
        }
    }
    wait(&fixture, "sim-0001", "state", "IDLE").await;
    ear.vanish().await;
    fixture.stop().await;
}
