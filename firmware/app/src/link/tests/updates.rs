//! What server and robot say to each other about updates, on its way through the link.

use std::format;
use std::vec::Vec;

use crawler_hal::Duration;
use crawler_protocol::{BuildId, ReleaseId, UpdateStage};
use crawler_release::chunk::{CHUNK_MAX, Chunk, PAYLOAD, Part};
use crawler_release::{PublicKey, PublicKeys, Want};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;

use super::harness::{Broker, run_updated};
use super::peer::Peer;
use crate::perception::LinkHealth;
use crate::update::{Have, Progress, Subject, UpdateIdentity, Updates, Word};

const TOPIC: &str = "swarm/ota/sim-0001";
const RELEASE: ReleaseId = ReleaseId::new([0x9f, 0x2c, 0x1a, 0xb0, 0x34, 0xd5, 0xe6, 0xf7]);

/// The base point of P-256 (SEC 2, section 2.4.2), compressed: a key like any other.
const POINT: [u8; 33] = [
    0x03, 0x6b, 0x17, 0xd1, 0xf2, 0xe1, 0x2c, 0x42, 0x47, 0xf8, 0xbc, 0xe6, 0xe5, 0x63, 0xa4, 0x40,
    0xf2, 0x77, 0x03, 0x7d, 0x81, 0x2d, 0xeb, 0x33, 0xa0, 0xf4, 0xa1, 0x39, 0x45, 0xd8, 0x98, 0xc2,
    0x96,
];

fn updates() -> Updates<NoopRawMutex> {
    Updates::new(UpdateIdentity {
        build: BuildId::new("1.0.0").expect("a build"),
        keys: Some(PublicKeys {
            current: PublicKey::from_sec1(&POINT).expect("a point"),
            next: None,
        }),
    })
}

async fn connected(broker: &Broker) -> Peer {
    let mut peer = broker.peer().await;
    let (_, filters) = peer.accept_with(false, 6).await;
    // QoS 1, No Local, nothing retained.
    assert_eq!(filters[5], format!("{TOPIC} 0x25"));
    peer.deliver_time();
    peer
}

fn chunk(index: u32) -> Vec<u8> {
    let chunk = Chunk {
        part: Part::Image,
        tag: RELEASE.tag(),
        index,
        payload: &[index as u8; PAYLOAD],
    };
    let mut bytes = [0; CHUNK_MAX];
    let length = chunk.encode(&mut bytes).expect("fits");
    bytes[..length].to_vec()
}

#[test]
fn reports_are_delivered_and_words_taken() {
    let updates = updates();
    run_updated(&updates, async |broker| {
        let mut peer = connected(&broker).await;
        broker.sleep(Duration::from_millis(200)).await;
        assert!(updates.take_session() && !updates.take_session());
        updates.tell_have(Have {
            sequence: 7,
            floor: 3,
            unfinished: Some((RELEASE, 65_536)),
        });
        updates.ask(Want::window(RELEASE.tag(), Part::Image, 32, 100));
        broker.robot.outbox.nudge();
        let have = peer.publish(TOPIC).await;
        assert_eq!((have.qos, have.retained), (1, false));
        let expected = serde_json::json!({
            "update": "have", "robot": "sim-0001", "build": "1.0.0", "sequence": 7, "floor": 3,
            "release": "9f2c1ab034d5e6f7", "bytes": 65_536,
        });
        assert_eq!(have.json(), expected);
        let want = peer.publish(TOPIC).await.json();
        let expected = serde_json::json!({
            "update": "want", "robot": "sim-0001", "tag": RELEASE.tag(), "part": "image",
            "first": 32, "missing": 0xFFFF,
        });
        assert_eq!(want, expected);

        for word in ["offer", "confirm", "cancel", "cancel", "have"] {
            let text = format!(r#"{{"update":"{word}","release":"{RELEASE}"}}"#);
            peer.deliver(TOPIC, text.as_bytes());
        }
        broker.sleep(Duration::from_millis(200)).await;
        assert_eq!(updates.take_word(), Some(Word::Offer(RELEASE, None)));
        assert_eq!(updates.take_word(), Some(Word::Confirm(RELEASE)));
        assert_eq!(updates.take_word(), Some(Word::Cancel(RELEASE)));
        assert_eq!(updates.take_word(), None, "said twice, or by a robot");
        assert_eq!(updates.linked(), (true, true));
        assert!(updates.is_told());

        peer.deliver(
            TOPIC,
            br#"{"update":"offer","release":"9f2c1ab034d5e6f7","more":1}"#,
        );
        let log = peer.publish("swarm/logs/").await.json();
        assert_eq!(
            (log["level"].as_str(), log["event"].as_str()),
            (Some("warn"), Some("update"))
        );
        assert_eq!(updates.take_word(), None);
    });
}

#[test]
fn a_chunk_waits_for_its_place_and_nothing_is_lost() {
    let updates = updates();
    run_updated(&updates, async |broker| {
        let mut peer = connected(&broker).await;
        // What was not asked for does not get a place.
        peer.throw(TOPIC, &chunk(0));
        broker.sleep(Duration::from_millis(200)).await;
        assert_eq!(updates.chunk(), None);

        updates.ask(Want::window(RELEASE.tag(), Part::Image, 0, 4));
        for index in [2, 2, 9, 0] {
            peer.throw(TOPIC, &chunk(index));
        }
        peer.throw(TOPIC, &chunk(1)[..500]);
        peer.command(1, "identify", "");
        broker.sleep(Duration::from_millis(100)).await;
        assert_eq!(updates.chunk(), Some((2, PAYLOAD)));
        // The robot goes on telling of itself meanwhile, and takes nothing.
        let told = peer.publishes_for(Duration::from_millis(800)).await;
        assert!(
            told.iter()
                .any(|said| said.topic == "swarm/telemetry/sim-0001")
        );
        assert_eq!(broker.robot.orders_waiting(), 0);

        let mut bytes = [0; PAYLOAD];
        updates.copy_out(0, &mut bytes);
        assert_eq!(bytes, [2; PAYLOAD]);
        updates.make_room();
        broker.sleep(Duration::from_millis(200)).await;
        assert_eq!(
            updates.chunk(),
            Some((0, PAYLOAD)),
            "neither the second 2, nor 9"
        );
        updates.make_room();
        broker.sleep(Duration::from_millis(200)).await;
        assert_eq!(updates.chunk(), None, "cut off");
        assert_eq!(broker.robot.orders_waiting(), 1, "the command was next");
        updates.close();
        peer.throw(TOPIC, &chunk(1));
        broker.sleep(Duration::from_millis(200)).await;
        assert_eq!(updates.chunk(), None);
    });
}

/// A broker may send a number for a topic that is as long as all else around a chunk (MQTT 5, section 3.3.2.3.4).
#[test]
fn a_topic_may_come_as_a_number_and_the_number_may_change() {
    const ALIAS: [u8; 3] = [0x23, 0, 1];
    let updates = updates();
    run_updated(&updates, async |broker| {
        let mut peer = connected(&broker).await;
        updates.ask(Want::window(RELEASE.tag(), Part::Image, 0, 16));
        for (index, topic) in [(0, TOPIC), (1, ""), (2, TOPIC), (3, ""), (4, "")] {
            // Between them what comes with its topic, which leaves the number alone.
            peer.deliver_time();
            peer.throw_with(topic, &ALIAS, &chunk(index));
            broker.sleep(Duration::from_millis(50)).await;
            assert_eq!(updates.chunk(), Some((index, PAYLOAD)));
            updates.make_room();
        }
        peer.throw_with("swarm/somewhere/else", &ALIAS, &chunk(5));
        peer.throw_with("", &ALIAS, &chunk(6));
        broker.sleep(Duration::from_millis(50)).await;
        assert_eq!(
            updates.chunk(),
            None,
            "the number stands for no topic of ours"
        );
        peer.throw(TOPIC, &chunk(5));
        broker.sleep(Duration::from_millis(50)).await;
        assert_eq!(updates.chunk(), Some((5, PAYLOAD)));
        assert_eq!(broker.health(), LinkHealth::Up);
        updates.make_room();

        // A number that nobody has explained ends the connection, and what one explained ends with it.
        peer.close();
        let mut peer = broker.peer().await;
        peer.accept_with(true, 6).await;
        peer.throw_with("", &ALIAS, &chunk(7));
        broker.sleep(Duration::from_millis(50)).await;
        assert_eq!(updates.chunk(), None);
        assert_eq!(broker.health(), LinkHealth::Lost);
    });
}

/// A flash that does not come back must not make the robot deaf.
#[test]
fn a_place_that_is_never_free_keeps_nobody_waiting_for_long() {
    let updates = updates();
    run_updated(&updates, async |broker| {
        let mut peer = connected(&broker).await;
        updates.ask(Want::window(RELEASE.tag(), Part::Image, 0, 16));
        for index in 0..16 {
            peer.throw(TOPIC, &chunk(index));
        }
        peer.command(1, "identify", "");
        broker.sleep(Duration::from_millis(900)).await;
        assert_eq!(broker.robot.orders_waiting(), 0);
        broker.sleep(Duration::from_millis(300)).await;
        assert_eq!(broker.robot.orders_waiting(), 1, "a second at most, in all");
        assert_eq!(updates.chunk(), Some((0, PAYLOAD)));
        // The link holds: it hears what the broker says.
        peer.publishes_for(Duration::from_secs(20)).await;
        assert_eq!(broker.health(), LinkHealth::Up);
    });
}

#[test]
fn what_the_broker_has_not_confirmed_is_sent_again_as_it_is_then() {
    for resumed in [true, false] {
        let updates = updates();
        run_updated(&updates, async |broker| {
            let mut peer = connected(&broker).await;
            peer.acknowledging = false;
            let progress = |bytes| Progress {
                release: RELEASE,
                stage: UpdateStage::Receiving,
                reason: None,
                bytes,
                of: Subject::Program,
            };
            updates.tell_progress(progress(1));
            broker.robot.outbox.nudge();
            assert_eq!(peer.publish(TOPIC).await.json()["bytes"], 1);
            updates.tell_progress(progress(2));
            broker.robot.outbox.nudge();
            broker.sleep(Duration::from_millis(200)).await;
            assert!(!updates.is_told(), "one at a time");
            peer.close();

            let mut peer = broker.peer().await;
            if resumed {
                // Sent again before the subscriptions, which takes it.
                peer.accept_with(true, 6).await;
            } else {
                peer.accept_with(false, 6).await;
                assert_eq!(peer.publish(TOPIC).await.json()["bytes"], 2);
            }
            let more = peer.publishes_for(Duration::from_secs(2)).await;
            assert!(more.iter().all(|said| said.topic != TOPIC), "{more:?}");
            assert!(updates.is_told());
        });
    }
}

/// Whether the session goes on or another begins.
#[test]
fn what_is_no_longer_waited_for_is_not_asked_for_after_a_lost_session() {
    for resumed in [true, false] {
        let updates = updates();
        run_updated(&updates, async |broker| {
            let mut peer = connected(&broker).await;
            peer.acknowledging = false;
            updates.ask(Want::window(RELEASE.tag(), Part::Image, 0, 16));
            broker.robot.outbox.nudge();
            assert_eq!(peer.publish(TOPIC).await.json()["missing"], 0xFFFF);
            updates.close();
            assert!(updates.is_told());
            peer.close();

            let mut peer = broker.peer().await;
            if resumed {
                // A number that is open has to be closed: sent once more, it asks for nothing.
                peer.connect().await;
                peer.send(&[0x20, 3, 1, 0, 0]);
                assert_eq!(peer.publish(TOPIC).await.json()["missing"], 0);
                for _ in 0..6 {
                    peer.grant(&peer.packet().await.expect("SUBSCRIBE"));
                }
            } else {
                peer.accept_with(false, 6).await;
            }
            let more = peer.publishes_for(Duration::from_secs(2)).await;
            assert!(more.iter().all(|said| said.topic != TOPIC), "{more:?}");
            assert!(updates.is_told());
            assert_eq!(broker.health(), LinkHealth::Up);
        });
    }
}

/// What has come meanwhile is not asked for again.
#[test]
fn a_lost_session_asks_for_what_is_missing_then() {
    let updates = updates();
    run_updated(&updates, async |broker| {
        let mut peer = connected(&broker).await;
        peer.acknowledging = false;
        updates.ask(Want::window(RELEASE.tag(), Part::Image, 0, 4));
        broker.robot.outbox.nudge();
        assert_eq!(peer.publish(TOPIC).await.json()["missing"], 0b1111);
        peer.throw(TOPIC, &chunk(2));
        broker.sleep(Duration::from_millis(200)).await;
        assert_eq!(updates.chunk(), Some((2, PAYLOAD)));
        updates.make_room();
        peer.close();

        let mut peer = broker.peer().await;
        peer.accept_with(false, 6).await;
        assert_eq!(peer.publish(TOPIC).await.json()["missing"], 0b1011);
    });
}
