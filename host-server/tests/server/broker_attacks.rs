//! A client that has a place at a closed broker and wants everything else.

use crate::support::mqtt;
use crate::support::mqtt::{Client, Closed, PASSWORD};
use crawler_access::Role;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{ConnectReturnCode, PubAckReason, SubscribeReasonCode};

/// Every topic of a fleet for a robot, and some that are none.
fn topics(fleet: &str, robot: &str) -> Vec<String> {
    let own = [
        "command/robot",
        "response/robot",
        "status",
        "heartbeat",
        "telemetry",
        "vision",
        "image",
        "logs",
        "parameters",
        "pose",
        "ota",
    ];
    let others = [
        "command/swarm",
        "command/experiment",
        "response/swarm",
        "simulator/command",
        "simulator/experiment",
        "simulator/response",
        "time",
        "cell/0/0",
        "cell/-7/3",
        "unheard-of",
    ];
    own.iter()
        .map(|kind| format!("{fleet}/{kind}/{robot}"))
        .chain(others.iter().map(|rest| format!("{fleet}/{rest}")))
        .collect()
}

/// What the robot `eve` may publish.
fn is_hers(topic: &str) -> bool {
    let rest = topic.strip_prefix("swarm/").unwrap_or_default();
    let kinds = [
        "response/robot/eve",
        "status/eve",
        "heartbeat/eve",
        "telemetry/eve",
        "vision/eve",
        "image/eve",
        "logs/eve",
        "parameters/eve",
        "ota/eve",
    ];
    kinds.contains(&rest)
}

/// Somebody who hears everything of the fleet.
async fn observer(closed: &Closed) -> Client {
    closed.person("ada", Role::Viewer).await;
    let mut ada = closed.connect("laptop", "ada", PASSWORD).await;
    let granted = ada.subscribe("swarm/#").await;
    assert!(matches!(granted, SubscribeReasonCode::Success(_)));
    ada
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_heard_on_its_own_topics_only() {
    let closed = Closed::start().await;
    let mut ada = observer(&closed).await;
    closed.enroll("rover-1").await;
    let mut eve = closed.robot("eve").await;
    let mut attempts: Vec<String> = [
        topics("swarm", "rover-1"),
        topics("swarm", "eve"),
        topics("swarm", "eve/x"),
        topics("swarm", "EVE"),
        topics("other", "eve"),
        topics("/swarm", "eve"),
        topics("$SYS/swarm", "eve"),
        topics("$share/g/swarm", "eve"),
    ]
    .concat();
    for odd in [
        "swarm",
        "swarm/",
        "/",
        "swarm//eve",
        "swarm/telemetry",
        "swarm/telemetry/",
        "swarm/telemetry/eve/",
        "swarm/telemetry//eve",
        "telemetry/eve",
        "swarm/command/robot/",
        "SWARM/telemetry/eve",
        "$SYS/brokers",
        "$delayed/1/swarm/command/swarm",
        "$exclusive/swarm/command/swarm",
    ] {
        attempts.push(odd.to_owned());
    }
    let mut hers = 0;
    for topic in &attempts {
        let retained = eve.retain(topic, "evil").await;
        let answer = eve.publish(topic, "evil").await;
        // The broker does not say whether anybody listens to what it has refused.
        if is_hers(topic) {
            hers += 1;
            assert_eq!(answer, PubAckReason::Success, "{topic}");
        } else {
            assert_eq!(answer, PubAckReason::NotAuthorized, "{topic}");
            assert_eq!(retained, PubAckReason::NotAuthorized, "{topic}");
        }
    }
    assert_eq!(hers, 9);
    // QoS 0 has no answer, and QoS 2 another.
    for qos in [QoS::AtMostOnce, QoS::ExactlyOnce] {
        let sent = eve
            .sender
            .publish("swarm/command/swarm", qos, false, "evil");
        sent.await.expect("a connection");
    }
    assert_eq!(
        eve.publish("swarm/heartbeat/eve", "last").await,
        PubAckReason::Success
    );
    loop {
        let heard = ada.next().await;
        let topic = String::from_utf8_lossy(&heard.topic).into_owned();
        // The server tells the time.
        assert!(is_hers(&topic) || topic == "swarm/time", "{topic}");
        assert!(!topic.contains("/ota/"), "{topic}");
        if heard.payload == "last" {
            break;
        }
    }
    let refused = 2 * (attempts.len() - hers) + 2;
    assert_eq!(closed.refusals("publish").await, refused as f64);
    // And nothing of it waits for those who come later.
    closed.person("bob", Role::Viewer).await;
    let mut bob = closed.connect("desk", "bob", PASSWORD).await;
    bob.subscribe("swarm/#").await;
    eve.publish("swarm/heartbeat/eve", "end").await;
    loop {
        let heard = bob.next().await;
        let topic = String::from_utf8_lossy(&heard.topic).into_owned();
        assert!(is_hers(&topic) || topic == "swarm/time", "{topic}");
        if heard.payload == "end" {
            break;
        }
    }
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_hears_what_is_meant_for_it_only() {
    let closed = Closed::start().await;
    closed.person("root", Role::Admin).await;
    let mut root = closed.connect("root", "root", PASSWORD).await;
    let mut victim = closed.robot("rover-1").await;
    let mut eve = closed.robot("eve").await;
    let mut wanted = topics("swarm", "rover-1");
    wanted.extend(topics("other", "eve"));
    // What she may have: see the table.
    let open = [
        "swarm/command/swarm",
        "swarm/command/experiment",
        "swarm/simulator/command",
        "swarm/time",
        "swarm/cell/0/0",
        "swarm/cell/-7/3",
    ];
    wanted.retain(|topic| !open.contains(&topic.as_str()));
    for filter in [
        "#",
        "+/#",
        "/#",
        "+",
        "+/+/+",
        "+/+/+/+",
        "swarm/#",
        "swarm/+/#",
        "swarm/+/rover-1",
        "swarm/+/eve",
        "swarm/command/#",
        "swarm/command/+",
        "swarm/command/robot/+",
        "swarm/command/robot/#",
        "swarm/command/robot/eve/#",
        "swarm/+/robot/eve",
        "+/command/robot/eve",
        "swarm/response/#",
        "swarm/cell/#",
        "swarm/pose/+",
        "swarm/ota/+",
        "swarm/simulator/#",
        "swarm/simulator/+",
        "$SYS/#",
        "$SYS/brokers/+",
        "$share/g/#",
        "$share/g/swarm/command/robot/rover-1",
        "$share/g/swarm/command/robot/eve",
        "$share/g/swarm/command/swarm",
        "$queue/swarm/command/swarm",
        "$exclusive/swarm/command/swarm",
    ] {
        wanted.push(filter.to_owned());
    }
    for filter in &wanted {
        let answer = eve.subscribe(filter).await;
        // The broker does not know this word, whoever says it.
        let expected = if filter.starts_with("$exclusive") {
            SubscribeReasonCode::TopicFilterInvalid
        } else {
            SubscribeReasonCode::NotAuthorized
        };
        assert_eq!(answer, expected, "{filter}");
    }
    let refused = wanted.len() - 1;
    assert_eq!(closed.refusals("subscribe").await, refused as f64);
    assert!(matches!(
        eve.subscribe("swarm/command/robot/eve").await,
        SubscribeReasonCode::Success(_)
    ));
    root.publish("swarm/command/robot/rover-1", "secret").await;
    victim.publish("swarm/telemetry/rover-1", "secret").await;
    root.publish("swarm/command/robot/eve", "hers").await;
    let heard = eve.next().await;
    assert_eq!(heard.payload, "hers", "{heard:?}");
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_will_is_a_publish() {
    let closed = Closed::start().await;
    let secret = closed.enroll("eve").await;
    for (topic, retain) in [
        ("swarm/status/rover-1", true),
        ("swarm/command/swarm", false),
        ("swarm/command/robot/eve", false),
        ("$SYS/brokers", false),
        // Her own topic, but nothing is retained on it.
        ("swarm/telemetry/eve", true),
    ] {
        let mut options = closed.options("eve", "eve", &secret);
        mqtt::will(&mut options, topic, retain);
        let code = mqtt::refused(options).await;
        assert_eq!(code, ConnectReturnCode::NotAuthorized, "{topic}");
    }
    assert_eq!(closed.refusals("will").await, 5.0);
    let mut options = closed.options("eve", "eve", &secret);
    mqtt::will(&mut options, "swarm/status/eve", true);
    Client::connect(options).await.expect("let in");
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_takes_over_who_somebody_else_is() {
    let closed = Closed::start().await;
    let eve = closed.enroll("eve").await;
    let lab = closed.enroll("simulator-lab").await;
    let zoo = closed.enroll("simulator-zoo").await;
    let desk = closed.enroll("learner-desk").await;
    for name in ["ada", "bob"] {
        closed.person(name, Role::Admin).await;
    }
    let mut robot = closed.robot("rover-1").await;
    let mut own = closed.connect("sim-0001", "simulator-lab", &lab).await;
    let ada = closed.connect("laptop", "ada", PASSWORD).await;
    let attempts = [
        ("rover-1", "eve", eve.as_str()),
        ("laptop", "eve", &eve),
        ("sim-0001", "eve", &eve),
        ("sim-0002", "eve", &eve),
        ("simulator-1", "eve", &eve),
        ("server-1", "eve", &eve),
        ("", "eve", &eve),
        ("eve ", "eve", &eve),
        ("rover-1", "simulator-lab", &lab),
        ("eve", "simulator-lab", &lab),
        ("laptop", "simulator-lab", &lab),
        ("sim-0001", "simulator-zoo", &zoo),
        ("learner-desk", "simulator-lab", &lab),
        ("learner-desk", "eve", &eve),
        ("learner-shelf", "learner-desk", &desk),
        ("desk", "learner-desk", &desk),
        ("sim-0002", "learner-desk", &desk),
        ("learner-desk", "ada", PASSWORD),
        ("learner-shelf", "ada", PASSWORD),
        ("rover-1", "ada", PASSWORD),
        ("eve", "ada", PASSWORD),
        ("sim-0009", "ada", PASSWORD),
        ("simulator-lab", "ada", PASSWORD),
        ("tracker-swarm", "ada", PASSWORD),
        ("laptop", "bob", PASSWORD),
    ];
    for (client_id, user, secret) in attempts {
        for clean in [true, false] {
            let mut options = closed.options(client_id, user, secret);
            // Without a name there is no session to come back to.
            options.set_clean_start(clean || client_id.is_empty());
            let code = mqtt::refused(options).await;
            assert_eq!(
                code,
                ConnectReturnCode::NotAuthorized,
                "{user} as {client_id:?}"
            );
        }
    }
    assert_eq!(
        closed.refusals("client_id").await,
        2.0 * attempts.len() as f64
    );
    for client in [&mut robot, &mut own] {
        assert!(client.is_connected());
    }
    assert!(ada.is_connected());
    assert_eq!(
        robot.publish("swarm/heartbeat/rover-1", "still here").await,
        PubAckReason::Success
    );

    // A robot that is enrolled has a right to its id, whoever has it.
    let mut squatter = closed.connect("rover-9", "bob", PASSWORD).await;
    let mut rightful = closed.robot("rover-9").await;
    squatter.ended().await;
    assert_eq!(
        rightful.publish("swarm/heartbeat/rover-9", "mine").await,
        PubAckReason::Success
    );
    // And comes back to its own session as before.
    let again = closed.enroll("rover-1").await;
    closed.connect("rover-1", "rover-1", &again).await;
    robot.ended().await;
    closed.stop().await;
}
