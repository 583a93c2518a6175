//! The table of who may publish and subscribe what, held against the embedded broker by clients
//! that log in and try.

use crate::support::mqtt;
use crate::support::mqtt::{Client, Closed, PASSWORD};
use crate::support::{Fixture, eventually, mqtt_options};
use crawler_access::Role;
use crawler_access::topics::{Act, Row, TABLE, Who};
use crawler_server::config::{Broker, Layer, Role as Part, Settings};
use crawler_server::server::Robots;
use rumqttc::v5::mqttbytes::v5::{ConnectReturnCode, PubAckReason, SubscribeReasonCode};

/// Everybody who can be, each with its place in the table.
struct Everybody(Vec<(&'static str, Who, Option<&'static str>, Client)>);

impl Everybody {
    async fn log_in(closed: &Closed) -> Self {
        let lab = closed.enroll("simulator-lab").await;
        let mut all = vec![
            (
                "robot",
                Who::Robot,
                Some("rover-1"),
                closed.robot("rover-1").await,
            ),
            (
                "simulated",
                Who::Robot,
                Some("sim-0001"),
                closed.connect("sim-0001", "simulator-lab", &lab).await,
            ),
            (
                "simulator",
                Who::Simulator,
                None,
                closed.connect("simulator-1", "simulator-lab", &lab).await,
            ),
            // Of the same name as the robot, and another.
            (
                "learner",
                Who::Learner,
                Some("rover-1"),
                closed.robot("learner-rover-1").await,
            ),
        ];
        for (name, role) in [
            ("viewer", Role::Viewer),
            ("operator", Role::Operator),
            ("admin", Role::Admin),
        ] {
            closed.person(name, role).await;
            let client = closed.connect(name, name, PASSWORD).await;
            all.push((name, Who::User(role), None, client));
        }
        Self(all)
    }
}

/// Whether a row is about somebody, said once more and in other words than the broker's.
fn is_about(row: &Row, who: Who) -> bool {
    match (row.who, who) {
        (Who::User(Role::Viewer), Who::User(_))
        | (Who::User(Role::Operator), Who::User(Role::Operator | Role::Admin)) => true,
        (row, who) => row == who,
    }
}

/// The topics of a row for a robot.
fn topics(row: &Row, own: &str) -> String {
    row.topics.replace("{fleet}", "swarm").replace("{own}", own)
}

/// A topic that is among them.
fn example(filter: &str) -> String {
    let filter = filter.replace("cell/+/+", "cell/-3/14");
    let filter = filter.replace("learn/+", "learn/42");
    filter.replace('+', "rover-1").replace('#', "command")
}

/// Whether somebody has a row with exactly these topics, or one with all of the fleet.
fn has_row(who: Who, own: Option<&str>, act: Act, filter: &str) -> bool {
    TABLE
        .iter()
        .filter(|row| row.act == act && is_about(row, who))
        .filter(|row| own.is_some() || !row.topics.contains("{own}"))
        .map(|row| topics(row, own.unwrap_or_default()))
        .any(|known| {
            let all = known == "swarm/#" && !filter.starts_with("swarm/ota/");
            all || known == filter || example(&known) == filter
        })
}

#[tokio::test(flavor = "multi_thread")]
async fn each_row_of_the_table_holds_for_everybody() {
    let closed = Closed::start().await;
    let Everybody(mut all) = Everybody::log_in(&closed).await;
    let mut outcomes = [0; 2];
    // The server's rows are its own: it is in the process, and nobody else has its secret.
    for row in TABLE.iter().filter(|row| row.who != Who::Server) {
        for owner in ["rover-1", "sim-0001", "rover-2"] {
            let filter = topics(row, owner);
            for (name, who, own, client) in &mut all {
                let what = format!("{name}: {:?} {filter}", row.act);
                let allowed = match row.act {
                    Act::Publish => {
                        let topic = example(&filter);
                        let allowed = has_row(*who, *own, Act::Publish, &topic);
                        let answer = client.publish(&topic, "{}").await;
                        let expected = if allowed {
                            [PubAckReason::Success, PubAckReason::NoMatchingSubscribers]
                        } else {
                            [PubAckReason::NotAuthorized; 2]
                        };
                        assert!(expected.contains(&answer), "{what}: {answer:?}");
                        allowed
                    }
                    Act::Subscribe => {
                        let allowed = has_row(*who, *own, Act::Subscribe, &filter);
                        let answer = client.subscribe(&filter).await;
                        let granted = matches!(answer, SubscribeReasonCode::Success(_));
                        assert_eq!(granted, allowed, "{what}: {answer:?}");
                        if !allowed {
                            assert_eq!(answer, SubscribeReasonCode::NotAuthorized, "{what}");
                        }
                        allowed
                    }
                };
                outcomes[usize::from(allowed)] += 1;
            }
        }
    }
    let [refused, allowed] = outcomes;
    assert!(refused > 100 && allowed > 100, "{outcomes:?}");
    assert!(
        closed.refusals("publish").await + closed.refusals("subscribe").await == f64::from(refused)
    );
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_allowed_arrives() {
    let closed = Closed::start().await;
    let mut robot = closed.robot("rover-1").await;
    closed.person("ada", Role::Operator).await;
    let mut ada = closed.connect("laptop", "ada", PASSWORD).await;
    for (client, filter) in [
        (&mut robot, "swarm/command/robot/rover-1"),
        (&mut ada, "swarm/#"),
    ] {
        let granted = client.subscribe(filter).await;
        assert!(matches!(granted, SubscribeReasonCode::Success(_)));
    }
    robot.publish("swarm/heartbeat/rover-1", "beat").await;
    assert_eq!(ada.message("swarm/heartbeat/rover-1").await.payload, "beat");
    ada.publish("swarm/command/robot/rover-1", "{}").await;
    assert_eq!(
        robot.message("swarm/command/robot/rover-1").await.payload,
        "{}"
    );
    // A will is published in its robot's name.
    let secret = closed.enroll("rover-2").await;
    let mut options = closed.options("rover-2", "rover-2", &secret);
    mqtt::will(&mut options, "swarm/status/rover-2", true);
    let second = Client::connect(options).await.expect("let in");
    second.vanish().await;
    assert_eq!(ada.message("swarm/status/rover-2").await.payload, "x");
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_gets_in_without_a_valid_name() {
    let closed = Closed::start().await;
    let secret = closed.enroll("rover-1").await;
    let other = closed.enroll("rover-2").await;
    closed.person("root", Role::Admin).await;
    closed.person("ada", Role::Operator).await;
    let nameless = mqtt_options("rover-1", closed.fixture.server.mqtt().port);
    assert_eq!(
        mqtt::refused(nameless).await,
        ConnectReturnCode::NotAuthorized
    );
    for (user, password) in [
        ("rover-1", other.as_str()),
        ("rover-1", PASSWORD),
        ("rover-3", &secret),
        ("ada", "correct mule!"),
        ("ada", &secret),
        ("eve", PASSWORD),
        ("simulator-lab", &secret),
        ("server", "server"),
        ("../records", &secret),
    ] {
        assert_eq!(
            closed.refusal("rover-1", user, password).await,
            ConnectReturnCode::BadUserNamePassword,
            "{user} {password}"
        );
    }
    assert_eq!(closed.refusals("nameless").await, 1.0);
    assert_eq!(closed.refusals("credentials").await, 9.0);

    closed.connect("rover-1", "rover-1", &secret).await;
    closed.connect("laptop", "ada", PASSWORD).await;
    // What was revoked or disabled counts no longer.
    closed
        .records
        .credentials()
        .revoke("rover-1", 2)
        .await
        .expect("revoked");
    let ada = "ada".parse().expect("a name");
    closed
        .records
        .users()
        .set_disabled(&ada, true, 2)
        .await
        .expect("disabled");
    for (user, password) in [("rover-1", secret.as_str()), ("ada", PASSWORD)] {
        assert_eq!(
            closed.refusal(user, user, password).await,
            ConnectReturnCode::BadUserNamePassword
        );
    }
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_this_process_log_in_by_themselves() {
    let fixture = Fixture::up("empty", |layer| {
        layer.open = Some(false);
        layer.robots = Some(3);
    })
    .await;
    let closed = Closed::around(fixture).await;
    closed.person("ada", Role::Viewer).await;
    let mut ada = closed.connect("laptop", "ada", PASSWORD).await;
    ada.subscribe("swarm/telemetry/+").await;
    for robot in ["sim-0001", "sim-0002", "sim-0003"] {
        ada.message(&format!("swarm/telemetry/{robot}")).await;
    }
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_another_process_log_in_with_one_secret() {
    let closed = Closed::start().await;
    let secret = closed.enroll("simulator-lab").await;
    let port = closed.fixture.server.mqtt().port;
    let sim = |secret: &str| {
        let url = format!("mqtt://simulator-lab:{secret}@127.0.0.1:{port}");
        let layer = Layer {
            broker: Some(url.parse().expect("a broker")),
            robots: Some(2),
            scenario: Some("empty".into()),
            ..Layer::default()
        };
        Settings::from_layers(Part::Sim, &[layer]).expect("settings")
    };
    let wrong = sim(&"A".repeat(43));
    assert!(matches!(wrong.broker, Broker::Outside(_)));
    let Err(error) = Robots::start(&wrong).await else {
        panic!("started with a wrong secret")
    };
    assert!(error.to_string().contains("refuses"), "{error}");

    closed.person("ada", Role::Operator).await;
    let mut ada = closed.connect("laptop", "ada", PASSWORD).await;
    ada.subscribe("swarm/#").await;
    let robots = Robots::start(&sim(&secret)).await.expect("started");
    ada.message("swarm/telemetry/sim-0001").await;
    ada.message("swarm/telemetry/sim-0002").await;
    // And its ear hears people.
    eventually("an answer of the simulator", async || {
        ada.publish("swarm/simulator/command", r#"{"command":"pause"}"#)
            .await;
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        ada.heard()
            .iter()
            .any(|topic| topic == "swarm/simulator/response")
    })
    .await;
    robots.stop().await;
    closed.stop().await;
}
