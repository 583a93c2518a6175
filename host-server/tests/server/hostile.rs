//! Bad input over MQTT: each has a clear answer and leaves everything else running.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::support::{FakeRobot, Fixture, eventually, heartbeat, mqtt_options, status, telemetry};
use rumqttc::v5::mqttbytes::QoS;
use serde_json::Value;

/// The value of a metric, 0 where it is not there yet.
async fn metric(fixture: &Fixture, name: &str) -> f64 {
    let metrics = fixture.get("/metrics").await;
    let line = metrics
        .text()
        .lines()
        .find_map(|line| line.strip_prefix(name));
    line.map_or(0.0, |value| value.trim().parse().expect("a number"))
}

#[tokio::test(flavor = "multi_thread")]
async fn nonsense_is_counted_and_ignored() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    for (topic, payload) in [
        ("swarm/telemetry/a", &b"{"[..]),
        ("swarm/telemetry/a", b"\xff\xfe"),
        ("swarm/telemetry/a", b""),
        ("swarm/heartbeat/a", b"null"),
        ("swarm/response/robot/a", b"[]"),
        ("swarm/logs/a", b"{\"robot\":\"a\"}"),
        ("swarm/parameters/a", b"{\"robot\":\"a\",\"values\":[]}"),
        ("swarm/status/a", b"true"),
    ] {
        robot.publish(topic, payload).await;
    }
    robot.publish("swarm/telemetry/a", telemetry("b", 1)).await;
    robot
        .publish("swarm/telemetry/NOT-AN-ID", telemetry("a", 1))
        .await;
    for (kind, count) in [("malformed", 8.0), ("mismatch", 1.0), ("robot_id", 1.0)] {
        let name = format!("terracrawler_mqtt_messages_rejected_total{{kind=\"{kind}\"}}");
        eventually(&name, async || metric(&fixture, &name).await == count).await;
    }
    let robots = fixture.get("/api/v1/robots").await.json();
    assert_eq!(
        robots["robots"].as_array().map(Vec::len),
        Some(1),
        "{robots}"
    );

    robot.publish("swarm/telemetry/a", telemetry("a", 2)).await;
    fixture.wait_presence("a", "online").await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_too_large_reaches_nobody() {
    let fixture = Fixture::start().await;
    let mut listener = fixture.robot("listener").await;
    let sender = fixture.robot("sender").await;
    sender
        .publish("swarm/command/swarm", vec![b'x'; 1_025])
        .await;
    sender
        .publish("swarm/telemetry/sender", vec![b'x'; 100_000])
        .await;
    // Retained, it would haunt every later subscriber.
    sender
        .send(
            "swarm/command/robot/listener",
            QoS::AtLeastOnce,
            true,
            b"{}".to_vec(),
        )
        .await;
    sender
        .publish("swarm/command/robot/listener", "after")
        .await;
    assert_eq!(
        listener.next("command/robot/listener").await.payload,
        "after"
    );
    eventually("counted", async || {
        metric(&fixture, "terracrawler_embedded_broker_oversize_total").await == 2.0
            && metric(
                &fixture,
                "terracrawler_embedded_broker_retain_refused_total",
            )
            .await
                == 1.0
    })
    .await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn strangers_with_names_are_refused() {
    let fixture = Fixture::start().await;
    let mut options = mqtt_options("stranger", fixture.server.mqtt().port);
    options.set_credentials("server", "guess");
    let (_client, mut events) = rumqttc::v5::AsyncClient::new(options, 10);
    let refused = events.poll().await.expect_err("refused").to_string();
    assert!(refused.contains("BadUserNamePassword"), "{refused}");
    assert_eq!(
        metric(&fixture, "terracrawler_embedded_broker_refused_total").await,
        1.0
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_robots_with_one_id_are_told_of() {
    let fixture = Fixture::start().await;
    // Two sessions, one robot id in what they say.
    let port = fixture.server.mqtt().port;
    let first = FakeRobot::connect(port, "twin-1", "twin").await;
    let second = FakeRobot::connect(port, "twin-2", "twin").await;
    let other = fixture.robot("other").await;
    other.introduce().await;
    first.introduce().await;
    for beat in 0..5 {
        first
            .publish("swarm/heartbeat/twin", heartbeat("twin", 500_000 + beat))
            .await;
        // Two connections: only an answer says which of two messages came first.
        eventually("the first beat", async || {
            fixture.get("/api/v1/robots/twin").await.json()["uptime_ms"] == 500_000 + beat
        })
        .await;
        second
            .publish("swarm/heartbeat/twin", heartbeat("twin", 1_000 + beat))
            .await;
        eventually("the second beat", async || {
            fixture.get("/api/v1/robots/twin").await.json()["uptime_ms"] == 1_000 + beat
        })
        .await;
    }
    assert_eq!(
        fixture.get("/api/v1/robots/twin").await.json()["duplicate"],
        true
    );
    assert_eq!(
        fixture.get("/api/v1/robots/other").await.json()["duplicate"],
        false
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_session_takes_over_and_the_robot_stays_online() {
    let fixture = Fixture::start().await;
    let statuses = "terracrawler_mqtt_messages_in_total{kind=\"status\"}";
    let old = fixture.robot("a").await;
    old.introduce().await;
    fixture.wait_presence("a", "online").await;
    eventually("the status has arrived", async || {
        metric(&fixture, statuses).await == 1.0
    })
    .await;
    let new = fixture.robot("a").await;
    new.introduce().await;
    // Its own, and the old session's will, which says that the robot is gone.
    eventually("the will has arrived", async || {
        metric(&fixture, statuses).await == 3.0
    })
    .await;
    // The new session goes on speaking.
    let mut uptime = 10;
    eventually("online", async || {
        uptime += 1;
        new.publish("swarm/heartbeat/a", heartbeat("a", uptime))
            .await;
        let robot = fixture.get("/api/v1/robots/a").await.json();
        robot["presence"] == "online" && robot["uptime_ms"].as_u64() > Some(10)
    })
    .await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_is_slowed_and_others_do_not_notice() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    let port = fixture.server.mqtt().port;
    let start = Instant::now();
    let flooders = Arc::new(AtomicU64::new(0));
    let flood = tokio::spawn(flood(port, Arc::clone(&flooders)));
    let delayed = "terracrawler_embedded_broker_delayed_total";
    // What is sent is heard while the flood goes on: before each there is more of that.
    let mut slowed = 10.0;
    for uptime in 1_000..1_020 {
        eventually("the flood is slowed", async || {
            metric(&fixture, delayed).await > slowed
        })
        .await;
        slowed = metric(&fixture, delayed).await;
        robot
            .publish("swarm/heartbeat/a", heartbeat("a", uptime))
            .await;
        eventually("heartbeat", async || {
            fixture.get("/api/v1/robots/a").await.json()["uptime_ms"] == uptime
        })
        .await;
    }
    // No more got through than each flooder may send at once and all of them in this time. How
    // quickly this machine is does not matter: that can only make it less.
    let received = "terracrawler_mqtt_messages_in_total{kind=\"telemetry\"}";
    let received = metric(&fixture, received).await;
    let at_once = 1_001.0 * flooders.load(Ordering::SeqCst) as f64;
    let most = at_once + 500.0 * start.elapsed().as_secs_f64() + 1.0;
    assert!(
        received <= most,
        "{received} messages got through of {most}"
    );
    flood.abort();
    fixture.stop().await;
}

/// Sends telemetry as fast as it can. Who is cut off for it is followed by another.
async fn flood(port: u16, flooders: Arc<AtomicU64>) {
    for number in 0_u32.. {
        let id = format!("flood-{number}");
        flooders.fetch_add(1, Ordering::SeqCst);
        let flooder = FakeRobot::connect(port, &id, &id).await;
        let topic = format!("swarm/telemetry/{id}");
        for seq in 0.. {
            let payload = telemetry(&id, seq);
            let sent = flooder
                .client
                .publish(&topic, QoS::AtMostOnce, false, payload);
            if sent.await.is_err() {
                break;
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_status_outlives_its_robot_in_the_broker() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    robot.vanish().await;
    fixture.wait_presence("a", "offline").await;
    let watcher = fixture.robot("watcher").await;
    let mut watcher = watcher;
    watcher
        .client
        .subscribe("swarm/status/+", QoS::AtLeastOnce)
        .await
        .expect("subscribe");
    let told = watcher.next("status/a").await;
    assert!(told.retain);
    let told: Value = serde_json::from_slice(&told.payload).expect("JSON");
    let will: Value = serde_json::from_str(&status("a", false)).expect("JSON");
    assert_eq!(told, will);
    fixture.stop().await;
}
