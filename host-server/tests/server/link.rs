//! Commands that meet a robot or a broker that is away.

use crate::support::port::ReservedPort;
use crate::support::{FakeRobot, Fixture, eventually};
use crawler_protocol::{Action, Command, ResponseStatus};
use crawler_server::server::Server;
use serde_json::json;

const SET: &str = r#"{"command":"set","parameters":{"safe_distance_mm":420}}"#;
const MOVE: &str =
    r#"{"command":"move","parameters":{"direction":"forward","speed":50,"duration":500}}"#;

async fn give(fixture: &Fixture, body: &str) -> String {
    let sent = fixture.post("/api/v1/robots/a/commands", body).await;
    assert_eq!(sent.status, 202, "{}", sent.text());
    sent.header("location").to_owned()
}

async fn wait_status(fixture: &Fixture, address: &str, status: &str) {
    eventually(status, async || {
        fixture.get(address).await.json()["status"] == status
    })
    .await;
}

/// A robot that was there and is gone.
async fn gone(fixture: &Fixture) {
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_told("a").await;
    robot.vanish().await;
    fixture.wait_presence("a", "offline").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn motion_expires_and_a_setting_waits_for_the_robot() {
    let fixture = Fixture::start().await;
    gone(&fixture).await;
    let motion = give(&fixture, MOVE).await;
    let set = give(&fixture, SET).await;
    let given = fixture.get(&motion).await.json()["timestamp"].as_u64();
    wait_status(&fixture, &motion, "expired").await;
    assert_eq!(fixture.get(&set).await.json()["status"], "pending");

    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    let command = robot.next_command().await;
    assert!(matches!(command.action, Action::Set(_)), "{command:?}");
    assert!(
        command.timestamp >= given.expect("a time") + 1_900,
        "a fresh time: that motion has expired since, which takes two seconds"
    );
    robot
        .answer(command.seq, ResponseStatus::Completed, None)
        .await;
    wait_status(&fixture, &set, "completed").await;
    assert_eq!(fixture.get(&motion).await.json()["status"], "expired");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_without_an_answer_comes_again_under_its_number() {
    let fixture = Fixture::start().await;
    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_told("a").await;
    let identify = give(&fixture, r#"{"command":"identify"}"#).await;
    let first = robot.next_command().await;
    // Both go on, but not past each other.
    let set = give(&fixture, SET).await;
    let again = robot.next_command().await;
    assert_eq!((again.seq, &again.action), (first.seq, &first.action));
    robot
        .answer(first.seq, ResponseStatus::Completed, None)
        .await;
    let next = after(&mut robot, first.seq).await;
    assert!(matches!(next.action, Action::Set(_)), "{next:?}");
    robot
        .answer(next.seq, ResponseStatus::Completed, None)
        .await;
    wait_status(&fixture, &identify, "completed").await;
    wait_status(&fixture, &set, "completed").await;
    // What is answered does not come again: not until another command has come, and again, for
    // which the time has passed after which they would.
    give(&fixture, r#"{"command":"identify"}"#).await;
    let last = after(&mut robot, next.seq).await;
    let again = robot.next_command().await;
    assert_eq!(again.seq, last.seq, "it is answered");
    fixture.stop().await;
}

/// The first command after the number `seq`. Those up to it may come again on the way, where the
/// machine is so slow that the answer to them takes longer than the server waits for it.
async fn after(robot: &mut FakeRobot, seq: u64) -> Command {
    loop {
        let command = robot.next_command().await;
        if command.seq > seq {
            return command;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_held_survives_the_server() {
    let fixture = Fixture::start().await;
    gone(&fixture).await;
    let set = give(&fixture, SET).await;
    let id = fixture.get(&set).await.json()["id"].clone();
    let settings = fixture.settings.clone();
    fixture.server.stop().await;
    let server = Server::start(&settings).await.expect("the server starts");
    let fixture = Fixture::of(server, settings);
    let known = fixture.get(&set).await.json();
    assert_eq!((&known["id"], &known["status"]), (&id, &json!("pending")));
    let mut robot = fixture.robot("a").await;
    robot.introduce().await;
    let command = robot.next_command().await;
    assert!(matches!(command.action, Action::Set(_)));
    robot
        .answer(command.seq, ResponseStatus::Completed, None)
        .await;
    wait_status(&fixture, &set, "completed").await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_setting_is_taken_without_a_broker_and_goes_when_it_is_back() {
    let held = ReservedPort::new();
    let port = held.port();
    let start_broker = || {
        Fixture::start_with(|layer| {
            layer.mqtt = Some(held.address());
        })
    };
    let broker = start_broker().await;
    let url = format!("mqtt://127.0.0.1:{port}").parse().expect("broker");
    let fixture = Fixture::start_with(|layer| {
        layer.mqtt = None;
        layer.broker = Some(url);
    })
    .await;
    let robot = FakeRobot::connect(port, "a", "a").await;
    robot.introduce().await;
    fixture.wait_told("a").await;
    broker.stop().await;
    eventually("not ready", async || {
        fixture.get("/readyz").await.status == 503
    })
    .await;
    let set = give(&fixture, SET).await;
    let refused = fixture.post("/api/v1/robots/a/commands", MOVE).await;
    refused.is_problem(503, "broker_unavailable");
    let broker = start_broker().await;
    let mut robot = FakeRobot::connect(port, "a", "a").await;
    robot.introduce().await;
    // The time is told at once, not when its turn comes.
    robot.next("/time").await;
    let command = robot.next_command().await;
    assert!(matches!(command.action, Action::Set(_)));
    robot
        .answer(command.seq, ResponseStatus::Completed, None)
        .await;
    wait_status(&fixture, &set, "completed").await;
    fixture.stop().await;
    broker.stop().await;
}
