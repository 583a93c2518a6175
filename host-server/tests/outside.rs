//! A broker that is not ours, and that goes away.

mod support;

use crawler_server::config::BrokerUrl;
use crawler_server::server::{Server, StartError};
use support::port::ReservedPort;
use support::{FakeRobot, Fixture, Scratch, eventually};

/// The embedded broker of one server serves as the outside broker of another.
async fn elsewhere(port: &ReservedPort) -> Fixture {
    Fixture::start_with(|layer| {
        layer.mqtt = Some(port.address());
    })
    .await
}

fn url(port: u16) -> BrokerUrl {
    format!("mqtt://127.0.0.1:{port}").parse().expect("broker")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_may_go_away_for_a_while() {
    let held = ReservedPort::new();
    let port = held.port();
    let broker = elsewhere(&held).await;
    let fixture = Fixture::start_with(|layer| {
        layer.mqtt = None;
        layer.broker = Some(url(port));
    })
    .await;
    let robot = FakeRobot::connect(port, "a", "a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;

    broker.stop().await;
    eventually("not ready", async || {
        fixture.get("/readyz").await.status == 503
    })
    .await;
    assert_eq!(fixture.get("/readyz").await.json()["broker"], false);
    assert_eq!(fixture.get("/healthz").await.status, 200);
    let refused = fixture
        .post("/api/v1/robots/a/commands", r#"{"command":"stop"}"#)
        .await;
    refused.is_problem(503, "broker_unavailable");
    eventually("silence shows", async || {
        fixture.get("/api/v1/robots/a").await.json()["presence"] == "stale"
    })
    .await;

    let broker = elsewhere(&held).await;
    eventually("ready again", async || {
        fixture.get("/readyz").await.status == 200
    })
    .await;
    let mut robot = FakeRobot::connect(port, "a", "a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    let sent = fixture
        .post("/api/v1/robots/a/commands", r#"{"command":"stop"}"#)
        .await;
    assert_eq!(sent.status, 202);
    // The command that was refused is not among what arrives.
    assert_eq!(sent.json()["seq"], robot.next_command().await.seq);
    fixture.stop().await;
    broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_that_is_not_there_is_an_error_at_the_start() {
    let held = ReservedPort::new();
    let port = held.port();
    let scratch = Scratch::new();
    let settings = support::settings(&scratch, |layer| {
        layer.mqtt = None;
        layer.broker = Some(url(port));
    });
    match Server::start(&settings).await.err() {
        Some(error @ StartError::BrokerUnreachable { .. }) => {
            let text = error.to_string();
            assert!(text.contains(&format!("mqtt://127.0.0.1:{port}")), "{text}");
            assert!(!text.contains('\n'), "{text}");
        }
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn something_that_is_no_broker_is_an_error_at_the_start() {
    // Our own web server speaks, but not MQTT.
    let fixture = Fixture::start().await;
    let scratch = Scratch::new();
    let settings = support::settings(&scratch, |layer| {
        layer.mqtt = None;
        layer.broker = Some(url(fixture.server.http().port()));
    });
    let error = Server::start(&settings).await.err();
    assert!(
        matches!(error, Some(StartError::BrokerUnreachable { .. })),
        "{error:?}"
    );
    fixture.stop().await;
}
