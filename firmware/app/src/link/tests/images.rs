//! Images on their way to the broker: whole, once, and across any loss.

use std::vec;
use std::vec::Vec;

use crawler_hal::Duration;

use super::harness::{Broker, Slot, run_with};
use super::peer::Peer;
use super::wire::{Publish, packet};
use crate::camera::{Image, Outcome};
use crate::perception::LinkHealth;

const SECOND: Duration = Duration::from_secs(1);

/// Larger than every buffer of the link.
fn jpeg() -> Vec<u8> {
    (0..9_000_u32).map(|byte| (byte * 7) as u8).collect()
}

/// Hands an image over as the camera does. The buffer is longer than the image.
fn hand_over(slot: &Slot, broker: &Broker, frame: u32) {
    let mut buffer = slot.lend().expect("the slot is free");
    let jpeg = jpeg();
    buffer[..jpeg.len()].copy_from_slice(&jpeg);
    slot.hand_over(Image::new(buffer, jpeg.len(), frame, 1_800_000_000_123));
    broker.robot.outbox.nudge();
}

/// Runs `script` with a slot of 16 KB.
fn run(script: impl AsyncFnOnce(Broker, &Slot)) {
    let slot = Slot::new(vec![0xEE; 16 * 1_024]);
    run_with(&slot, |broker| script(broker, &slot));
}

/// A user property as it is on the wire (section 2.2.2.2 of MQTT 5).
fn user_property(name: &str, value: &str) -> Vec<u8> {
    let mut bytes = vec![0x26];
    for text in [name, value] {
        bytes.extend((text.len() as u16).to_be_bytes());
        bytes.extend(text.as_bytes());
    }
    bytes
}

fn is_whole(image: &Publish) {
    assert_eq!(image.topic, "swarm/image/sim-0001");
    assert_eq!((image.qos, image.retained), (1, false));
    assert!(image.payload == jpeg(), "{} bytes", image.payload.len());
    for property in [
        user_property("frame", "7"),
        user_property("timestamp", "1800000000123"),
        b"\x03\x00\x0aimage/jpeg".to_vec(),
    ] {
        let found = image.properties.windows(property.len());
        assert!(found.into_iter().any(|part| part == property), "{image:?}");
    }
}

#[test]
fn an_image_arrives_with_its_number_and_time_and_frees_the_buffer() {
    run(async |broker, slot| {
        let peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        for _ in 0..3 {
            hand_over(slot, &broker, 7);
            let image = peer.publish("swarm/image/").await;
            is_whole(&image);
            assert!(!image.again);
            assert_eq!(slot.settled().await, Outcome::Delivered);
        }
    });
}

#[test]
fn an_image_waits_for_its_acknowledgement_and_nothing_else_does() {
    run(async |broker, slot| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        peer.acknowledging = false;
        hand_over(slot, &broker, 7);
        let image = peer.publish("swarm/image/").await;
        let beats = peer.publishes_for(SECOND * 3).await;
        let heard = |prefix| beats.iter().filter(|p| p.topic.starts_with(prefix)).count();
        assert!(heard("swarm/heartbeat/") >= 2);
        assert_eq!(heard("swarm/image/"), 0, "not sent twice on one connection");
        assert!(slot.lend().is_none(), "the buffer is still the link's");
        peer.acknowledge(image.id.expect("QoS 1"));
        assert_eq!(slot.settled().await, Outcome::Delivered);
        assert!(slot.lend().is_some());
    });
}

/// Loses the connection under an image that is not acknowledged; what comes on the next one.
async fn after_loss(broker: &Broker, slot: &Slot, session_present: bool) -> (Publish, Publish) {
    let mut peer = broker.connected().await;
    peer.publish("swarm/parameters/").await;
    peer.acknowledging = false;
    hand_over(slot, broker, 7);
    let first = peer.publish("swarm/image/").await;
    peer.close();
    let mut peer = broker.peer().await;
    let second = accept_and_hear(&mut peer, session_present).await;
    assert_eq!(slot.settled().await, Outcome::Delivered);
    let more = peer.publishes_for(SECOND * 15).await;
    assert!(!more.iter().any(|p| p.topic.starts_with("swarm/image/")));
    (first, second)
}

/// Answers CONNECT and the five SUBSCRIBEs; the image that comes meanwhile or afterwards.
async fn accept_and_hear(peer: &mut Peer, session_present: bool) -> Publish {
    peer.connect().await;
    peer.send(&[0x20, 3, u8::from(session_present), 0, 0]);
    let mut image = None;
    let mut granted = 0;
    loop {
        let next = peer.packet().await.expect("the connection stays open");
        if next.kind() == 8 {
            peer.grant(&next);
            granted += 1;
        } else if let Some(publish) = peer.serve(&next)
            && publish.topic.starts_with("swarm/image/")
        {
            image = Some(publish);
        }
        if granted == 5
            && let Some(image) = image.take()
        {
            return image;
        }
    }
}

#[test]
fn an_unacknowledged_image_is_sent_again_under_its_number_in_a_kept_session() {
    run(async |broker, slot| {
        let (first, second) = after_loss(&broker, slot, true).await;
        is_whole(&second);
        assert_eq!((first.again, second.again), (false, true));
        assert_eq!(first.id, second.id);
    });
}

#[test]
fn an_unacknowledged_image_is_sent_anew_when_the_session_is_forgotten() {
    run(async |broker, slot| {
        let (_, second) = after_loss(&broker, slot, false).await;
        is_whole(&second);
        assert!(!second.again);
    });
}

#[test]
fn an_image_torn_in_the_middle_is_sent_again_whole() {
    run(async |broker, slot| {
        let peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        peer.stall();
        hand_over(slot, &broker, 7);
        while broker.health() != LinkHealth::Lost {
            broker.sleep(Duration::from_millis(100)).await;
        }
        let mut peer = broker.peer().await;
        is_whole(&accept_and_hear(&mut peer, true).await);
        assert_eq!(slot.settled().await, Outcome::Delivered);
    });
}

#[test]
fn an_image_taken_while_away_is_delivered_afterwards() {
    run(async |broker, slot| {
        broker.refuse_connections(true);
        broker.sleep(SECOND * 20).await;
        hand_over(slot, &broker, 7);
        broker.sleep(SECOND * 20).await;
        broker.refuse_connections(false);
        let mut peer = broker.peer().await;
        is_whole(&accept_and_hear(&mut peer, false).await);
        assert_eq!(slot.settled().await, Outcome::Delivered);
    });
}

/// CONNACK of a broker that takes packets of at most `bytes`.
fn narrow(bytes: u32, session_present: bool) -> Vec<u8> {
    let mut body = vec![u8::from(session_present), 0, 5, 0x27];
    body.extend(bytes.to_be_bytes());
    packet(0x20, &body)
}

#[test]
fn an_image_above_the_brokers_largest_packet_is_not_sent() {
    run(async |broker, slot| {
        let mut peer = broker.peer().await;
        peer.connect().await;
        peer.send(&narrow(9_000, false));
        while !peer.is_subscribed().await {}
        peer.publish("swarm/parameters/").await;
        hand_over(slot, &broker, 7);
        assert_eq!(slot.settled().await, Outcome::TooLarge);
        let more = peer.publishes_for(SECOND * 5).await;
        assert!(!more.iter().any(|p| p.topic.starts_with("swarm/image/")));
        assert!(more.len() > 10, "the connection goes on");
        assert_eq!(broker.attempts().len(), 1);
    });
}

#[test]
fn an_image_that_no_longer_fits_the_broker_ends_the_session_and_not_the_link() {
    run(async |broker, slot| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        peer.acknowledging = false;
        hand_over(slot, &broker, 7);
        peer.publish("swarm/image/").await;
        peer.close();
        let peer = broker.peer().await;
        peer.connect().await;
        peer.send(&narrow(9_000, true));
        assert_eq!(slot.settled().await, Outcome::TooLarge);
        let mut peer = broker.peer().await;
        assert!(peer.accept(false).await.0.clean, "a new session");
        peer.publish("swarm/status/").await;
    });
}

#[test]
fn an_image_that_the_broker_rejects_is_given_up() {
    // Quota exceeded, not authorised, and what no code of section 3.4.2.1 says better.
    for code in [0x97, 0x87, 0x80] {
        run(async |broker, slot| {
            let mut peer = broker.connected().await;
            peer.publish("swarm/parameters/").await;
            peer.acknowledging = false;
            hand_over(slot, &broker, 7);
            let image = peer.publish("swarm/image/").await;
            let [high, low] = image.id.expect("QoS 1").to_be_bytes();
            peer.send(&[0x40, 3, high, low, code]);
            assert_eq!(slot.settled().await, Outcome::Refused);
            assert_eq!(broker.health(), LinkHealth::Up);
        });
    }
}

#[test]
fn messages_with_user_properties_are_understood() {
    run(async |broker, _| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        // Fewer than, as many as, and more than the link keeps of them.
        for count in 0..5_u64 {
            let properties: Vec<u8> = (0..count)
                .flat_map(|_| user_property("who", "operator"))
                .collect();
            peer.command_with(1 + count, "capture", &properties);
            let answer = peer.publish("swarm/response/").await;
            assert_eq!(answer.json()["seq"], 1 + count);
        }
    });
}
