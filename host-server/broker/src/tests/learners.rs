//! Machines of federated learning: one account, one client id, and few topics.

use crawler_access::{MAX_ROUND, MAX_UPDATE};

use super::updates::Listener;
use super::*;

const NAME: &str = "learner-desk";
const ROUND: &str = "swarm/learn/42/round";
const UPDATE: &str = "swarm/learn/42/update/desk";

/// With room for a round, which the library has not by itself.
fn large(mut options: MqttOptions) -> MqttOptions {
    options.set_max_packet_size(Some(LARGEST_PACKET));
    options
}

impl Bench {
    async fn learner(&self) -> Listener {
        let secret = self.enroll(NAME).await;
        Listener::connect(large(self.options(NAME, NAME, &secret))).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_goes_by_its_name_and_nobody_else_does() {
    let bench = Bench::new().await;
    let own = bench.enroll(NAME).await;
    let other = bench.enroll("learner-shelf").await;
    let lab = bench.enroll("simulator-lab").await;
    let robot = bench.enroll("desk").await;
    bench.person("ada", Role::Admin).await;
    // The prefix alone is nobody's, whatever the records have.
    let bare = bench.enroll("learner-").await;
    let mut learner = bench.connect(NAME, NAME, &own).await.expect("let in");
    for (client_id, user, secret, expected) in [
        (
            NAME,
            "learner-shelf",
            other.as_str(),
            ConnectReturnCode::NotAuthorized,
        ),
        (
            NAME,
            "simulator-lab",
            &lab,
            ConnectReturnCode::NotAuthorized,
        ),
        (NAME, "desk", &robot, ConnectReturnCode::NotAuthorized),
        (NAME, "ada", PASSWORD, ConnectReturnCode::NotAuthorized),
        (
            "learner-hall",
            "ada",
            PASSWORD,
            ConnectReturnCode::NotAuthorized,
        ),
        ("desk", NAME, &own, ConnectReturnCode::NotAuthorized),
        (
            "learner-desk-2",
            NAME,
            &own,
            ConnectReturnCode::NotAuthorized,
        ),
        ("sim-0001", NAME, &own, ConnectReturnCode::NotAuthorized),
        (NAME, NAME, &other, ConnectReturnCode::BadUserNamePassword),
        (NAME, NAME, PASSWORD, ConnectReturnCode::BadUserNamePassword),
        (
            "learner-",
            "learner-",
            &bare,
            ConnectReturnCode::BadUserNamePassword,
        ),
    ] {
        let refused = bench.connect(client_id, user, secret).await;
        assert_eq!(refused.err(), Some(expected), "{user} as {client_id}");
    }
    learner.is_heard(UPDATE).await;
    // A robot of the same name is another, and stays when the learner goes.
    let mut robot = bench.connect("desk", "desk", &robot).await.expect("let in");
    let revoked = bench.records.credentials().revoke(NAME, 2).await;
    revoked.expect("revoked");
    bench.broker.handle().drop_client(Kind::Machine, NAME).await;
    learner.ends().await;
    robot.is_heard("swarm/heartbeat/desk").await;
    let again = bench.connect(NAME, NAME, &own).await;
    assert_eq!(again.err(), Some(ConnectReturnCode::BadUserNamePassword));
    bench.broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_round_waits_for_learners_and_updates_reach_the_server() {
    let bench = Bench::new().await;
    let Credentials { user, password } = bench.broker.server();
    let options = bench.options(user, user, &password.to_string());
    let mut server = Listener::connect(large(options)).await;
    assert!(server.subscribe("swarm/learn/+/update/+").await);
    let round = vec![b'r'; MAX_ROUND];
    let sent = server
        .sender
        .publish(ROUND, QoS::AtLeastOnce, true, round.clone());
    sent.await.expect("a session");
    server
        .wait("the round is taken", |packet| {
            matches!(packet, Packet::PubAck(_)).then_some(())
        })
        .await;

    // It comes later, and gets what is retained.
    let mut learner = bench.learner().await;
    assert!(learner.subscribe("swarm/learn/+/round").await);
    let heard = learner.message(ROUND).await;
    assert_eq!(heard.payload, round);
    assert!(heard.retain);
    let one = learner.subscribe(ROUND).await;
    assert!(one, "one run's rounds alone");
    for filter in ["swarm/learn/#", "swarm/learn/+/update/+", "swarm/#", UPDATE] {
        assert!(!learner.subscribe(filter).await, "{filter}");
    }

    let update = vec![b'u'; MAX_UPDATE + 1];
    let taken = learner.publish(UPDATE, &update[..MAX_UPDATE]).await;
    assert_eq!(taken, PubAckReason::Success);
    assert_eq!(server.message(UPDATE).await.payload, update[..MAX_UPDATE]);
    let refused = learner.publish(UPDATE, &update).await;
    assert_eq!(refused, PubAckReason::QuotaExceeded);
    for topic in [
        "swarm/learn/42/update/shelf",
        "swarm/learn/x/update/desk",
        ROUND,
        "swarm/telemetry/desk",
    ] {
        let refused = learner.publish(topic, b"{}").await;
        assert_eq!(refused, PubAckReason::NotAuthorized, "{topic}");
    }
    // Nothing of a learner stays at the broker.
    let retained = learner.sender.publish(UPDATE, QoS::AtLeastOnce, true, "{}");
    retained.await.expect("a session");
    let refused = learner
        .wait("an acknowledgement", |packet| match packet {
            Packet::PubAck(ack) => Some(ack.reason),
            _ => None,
        })
        .await;
    assert_eq!(refused, PubAckReason::QuotaExceeded);
    let counters = bench.broker.handle().counters;
    assert_eq!(counters.oversize.load(Ordering::Relaxed), 1);
    assert_eq!(counters.retain_refused.load(Ordering::Relaxed), 1);
    bench.broker.stop().await;
}
