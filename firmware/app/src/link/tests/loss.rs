//! What happens when things go wrong.

use std::vec::Vec;

use crawler_hal::{Clock, Duration, Instant};
use crawler_protocol::{ResponseStatus, Source};
use proptest::prelude::*;

use super::harness::{Broker, run};
use super::peer::Peer;
use super::wire::{Publish, command, field, packet, split_publish};
use crate::link::{
    ACKNOWLEDGED_WITHIN, KEEP_ALIVE, LONGEST, LOST_AFTER, OPENED_WITHIN, PING_AFTER, SHORTEST,
    STABLE_AFTER, SUSPICIOUS, TAKEN_OVER,
};
use crate::perception::LinkHealth;

const SECOND: Duration = Duration::from_secs(1);

fn answer(broker: &Broker, seq: u64) {
    let source = Source::new("operator:ada").expect("a source");
    let now = broker.clock.now();
    let status = ResponseStatus::Completed;
    broker.robot.respond(&source, seq, status, None, now);
}

/// Waits until the link calls itself lost; how long that took.
async fn until_lost(broker: &Broker) -> Duration {
    let start = broker.clock.now();
    while broker.health() != LinkHealth::Lost {
        broker.sleep(Duration::from_millis(10)).await;
        let waited = broker.clock.now() - start;
        assert!(waited < SECOND * 60, "the loss was never noticed");
    }
    broker.clock.now() - start
}

#[test]
fn a_silent_broker_is_asked_and_then_given_up() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        peer.answering_pings = false;
        peer.acknowledging = true;
        let silent_since = broker.clock.now();
        let pinged = async {
            loop {
                let packet = peer.packet().await.expect("still open");
                if packet.kind() == 12 {
                    return broker.clock.now() - silent_since;
                }
            }
        };
        let pinged = pinged.await;
        assert!(pinged <= PING_AFTER + SECOND, "ping after {pinged:?}");
        let lost = until_lost(&broker).await + pinged;
        assert!(lost <= LOST_AFTER + SECOND, "lost after {lost:?}");
        assert!(lost * 2 <= KEEP_ALIVE * 3);
        peer.dropped().await;
        let mut peer = broker.peer().await;
        peer.accept(true).await;
        peer.publish("swarm/status/").await;
        assert_eq!(broker.health(), LinkHealth::Up);
    });
}

#[test]
fn a_broker_that_answers_pings_is_kept_however_little_it_says() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publishes_for(SECOND * 120).await;
        assert_eq!(broker.health(), LinkHealth::Up);
        assert_eq!(broker.attempts().len(), 1);
    });
}

#[test]
fn a_broker_that_takes_no_more_bytes_is_given_up() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        peer.stall();
        let lost = until_lost(&broker).await;
        assert!(lost * 2 <= KEEP_ALIVE * 3, "lost after {lost:?}");
    });
}

#[test]
fn a_stalled_broker_that_keeps_talking_is_given_up_too() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        peer.stall();
        for _ in 0..10 {
            peer.deliver_time();
            broker.sleep(SECOND).await;
        }
        assert_eq!(broker.health(), LinkHealth::Lost);
    });
}

#[test]
fn a_closed_connection_and_a_lost_network_are_noticed_at_once() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        peer.close();
        assert!(until_lost(&broker).await <= Duration::from_millis(20));
        let mut peer = broker.peer().await;
        peer.accept(false).await;
        peer.publish("swarm/status/").await;
        broker.take_network_down(true);
        assert!(until_lost(&broker).await <= Duration::from_millis(220));
        let before = broker.attempts().len();
        broker.sleep(SECOND * 5).await;
        assert_eq!(
            broker.attempts().len(),
            before,
            "no stream without a network"
        );
        broker.take_network_down(false);
        broker.peer().await;
    });
}

async fn unacknowledged_answer(broker: &Broker, session_present: bool) -> (u16, u16, bool) {
    let mut peer = broker.connected().await;
    peer.publish("swarm/parameters/").await;
    broker.sleep(Duration::from_millis(50)).await;
    peer.acknowledging = false;
    answer(broker, 5);
    answer(broker, 6);
    let first = peer.publish("swarm/response/").await;
    assert!(!first.again);
    peer.publish("swarm/response/").await;
    peer.close();
    let mut peer = broker.peer().await;
    peer.acknowledging = false;
    let connect = peer.connect().await;
    assert!(!connect.clean, "the session is to be continued");
    peer.send(&[0x20, 3, u8::from(session_present), 0, 0]);
    let mut seen: Vec<Publish> = Vec::new();
    while seen.len() < 2 {
        let packet = peer.packet().await.expect("open");
        if packet.kind() == 8 {
            peer.grant(&packet);
        } else if packet.kind() == 3 {
            let publish = split_publish(&packet);
            if publish.topic.starts_with("swarm/response/") {
                seen.push(publish);
            }
        }
    }
    let seqs: Vec<_> = seen.iter().map(|p| p.json()["seq"].as_u64()).collect();
    assert_eq!(seqs, [Some(5), Some(6)], "the order is kept");
    assert_eq!(broker.robot.outbox.pending(), 2);
    for publish in &seen {
        peer.acknowledge(publish.id.expect("QoS 1"));
    }
    broker.sleep(Duration::from_millis(10)).await;
    assert_eq!(broker.robot.outbox.pending(), 0, "acknowledged at last");
    (
        first.id.expect("QoS 1"),
        seen[0].id.expect("QoS 1"),
        seen[0].again,
    )
}

#[test]
fn an_unacknowledged_answer_is_sent_again_under_its_number_in_a_kept_session() {
    let (before, after, again) = run(async |broker| unacknowledged_answer(&broker, true).await);
    assert_eq!(before, after);
    assert!(again);
}

#[test]
fn an_unacknowledged_answer_is_sent_anew_when_the_session_is_forgotten() {
    let (_, _, again) = run(async |broker| unacknowledged_answer(&broker, false).await);
    assert!(!again);
}

#[test]
fn an_answer_torn_in_the_middle_is_sent_again() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        broker.sleep(Duration::from_millis(50)).await;
        peer.stall();
        answer(&broker, 5);
        until_lost(&broker).await;
        let mut peer = broker.peer().await;
        peer.accept(true).await;
        let response = peer.publish("swarm/response/").await;
        assert_eq!(response.json()["seq"], 5);
    });
}

#[test]
fn a_missing_acknowledgement_ends_the_connection() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        broker.sleep(Duration::from_millis(50)).await;
        peer.acknowledging = false;
        answer(&broker, 1);
        let start = broker.clock.now();
        peer.publishes_for(ACKNOWLEDGED_WITHIN + SECOND).await;
        assert_eq!(broker.health(), LinkHealth::Lost);
        assert!(broker.clock.now() - start <= ACKNOWLEDGED_WITHIN + SECOND);
    });
}

#[test]
fn answers_given_while_away_are_delivered_afterwards() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        broker.refuse_connections(true);
        peer.close();
        until_lost(&broker).await;
        for seq in 1..=12 {
            answer(&broker, seq);
        }
        broker.sleep(SECOND * 60).await;
        broker.refuse_connections(false);
        let mut peer = broker.peer().await;
        peer.accept(false).await;
        let all = peer.publishes_for(SECOND * 2).await;
        let seqs: Vec<_> = all
            .iter()
            .filter(|p| p.topic.starts_with("swarm/response/"))
            .filter_map(|p| p.json()["seq"].as_u64())
            .collect();
        // Four went out with CONNECT's subscriptions, inside `accept`.
        assert!(seqs.ends_with(&[9, 10, 11, 12]), "{seqs:?}");
        assert_eq!(broker.robot.outbox.pending(), 0);
    });
}

#[test]
fn attempts_become_rarer_and_short_again_after_a_stable_session() {
    run(async |broker| {
        broker.refuse_connections(true);
        broker.peer().await.close();
        broker.sleep(SECOND * 300).await;
        let attempts = broker.attempts();
        let waits: Vec<Duration> = attempts.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(waits[0] <= SHORTEST && waits[0] * 2 >= SHORTEST);
        assert!(waits.iter().all(|wait| *wait <= LONGEST));
        assert!(waits.last().expect("many") >= &(SECOND * 3), "{waits:?}");
        assert!((40..120).contains(&attempts.len()), "{}", attempts.len());
        broker.refuse_connections(false);
        let peer = broker.connected().await;
        peer.publishes_for(STABLE_AFTER + SECOND).await;
        peer.close();
        let closed = broker.clock.now();
        broker.peer().await;
        assert!(broker.clock.now() - closed <= SHORTEST + Duration::from_millis(20));
    });
}

#[test]
fn a_broker_that_accepts_a_stream_and_says_nothing_is_left_in_time() {
    run(async |broker| {
        let peer = broker.peer().await;
        let start = broker.clock.now();
        peer.dropped().await;
        assert!(broker.clock.now() - start <= OPENED_WITHIN + Duration::from_millis(1));
        assert_eq!(broker.health(), LinkHealth::Absent);
    });
}

#[test]
fn refused_subscriptions_are_not_taken_for_a_session() {
    run(async |broker| {
        let peer = broker.peer().await;
        peer.connect().await;
        peer.send(&[0x20, 3, 0, 0, 0]);
        loop {
            let packet = peer.packet().await.expect("open");
            if packet.kind() == 8 {
                // Not authorised.
                peer.send(&[0x90, 4, packet.body[0], packet.body[1], 0, 0x87]);
                break;
            }
        }
        peer.dropped().await;
        assert_eq!(broker.health(), LinkHealth::Absent);
        let start = broker.clock.now();
        broker.peer().await;
        assert!(broker.clock.now() - start >= SECOND * 15, "no hammering");
    });
}

#[test]
fn a_second_robot_with_the_same_id_does_not_start_a_war() {
    run(async |broker| {
        let peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        // DISCONNECT, session taken over.
        peer.send(&[0xe0, 2, 0x8e, 0]);
        peer.dropped().await;
        let start = broker.clock.now();
        assert_eq!(until_lost(&broker).await, Duration::ZERO);
        let mut peer = broker.peer().await;
        let waited = broker.clock.now() - start;
        assert!(
            waited * 2 >= TAKEN_OVER && waited <= TAKEN_OVER,
            "{waited:?}"
        );
        let (connect, _) = peer.accept(false).await;
        assert!(connect.clean, "the session has been the other's");
        let record = peer.publish("swarm/logs/").await.json();
        assert_eq!(field(&record, "event"), "link-lost");
        assert!(field(&record, "text").contains("another robot with this id"));
    });
}

/// Closes [`SUSPICIOUS`] sessions soon after they began. Those behind the first go on with one that the broker knows, or
/// with none. How long the robot waits then, and whether it tells of a second robot with its id.
async fn closed_again_and_again(broker: &Broker, known: bool) -> (Duration, bool) {
    for nth in 0..SUSPICIOUS {
        let mut peer = broker.peer().await;
        let (connect, _) = peer.accept(known && nth > 0).await;
        assert_eq!(connect.clean, nth == 0);
        peer.publish("swarm/status/").await;
        broker.sleep(SECOND * 2).await;
        peer.close();
    }
    let closed = broker.clock.now();
    let mut peer = broker.peer().await;
    let waited = broker.clock.now() - closed;
    peer.accept(known).await;
    let records = peer.publishes_for(SECOND).await;
    let told = records
        .iter()
        .filter(|p| p.topic.starts_with("swarm/logs/"))
        .any(|p| field(&p.json(), "text").contains("another robot with this id"));
    (waited, told)
}

#[test]
fn a_second_robot_with_the_same_id_is_suspected_even_when_the_broker_does_not_say_so() {
    run(async |broker| {
        // The session that goes on is the other's.
        let (waited, told) = closed_again_and_again(&broker, true).await;
        assert!(waited * 2 >= TAKEN_OVER, "{waited:?}");
        assert!(told);
    });
}

#[test]
fn a_broker_that_ends_again_and_again_is_no_second_robot() {
    run(async |broker| {
        // What has started anew knows no session.
        let (waited, told) = closed_again_and_again(&broker, false).await;
        assert!(waited <= LONGEST, "{waited:?}");
        assert!(!told);
    });
}

async fn disturbed(broker: &Broker, peer: Peer, bytes: &[u8]) {
    peer.send(bytes);
    broker.sleep(LOST_AFTER + SECOND * 2).await;
    drop(peer);
    // Whatever that was: the robot is there, or comes back.
    let attempts = broker.attempts().len();
    if attempts > 1 || broker.health() == LinkHealth::Lost {
        let mut peer = broker.peer().await;
        peer.accept(false).await;
        peer.publish("swarm/status/").await;
    }
}

#[test]
fn bytes_that_are_not_mqtt_end_the_connection_and_nothing_else() {
    let large = packet(0x30, &std::vec![0; 70_000]);
    let cases: &[&[u8]] = &[
        &[0x00, 0x00],
        &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff],
        &[0x30, 0xff, 0xff, 0xff, 0x7f],
        &large,
        // CONNACK twice, SUBACK of nothing, SUBACK cut short, PUBLISH with a topic alias.
        &[0x20, 3, 0, 0, 0],
        &[0x90, 4, 0, 0, 0, 0],
        &[0x90, 1, 0],
        &[0x30, 6, 0, 0, 3, 0x23, 0, 1],
        // PUBLISH whose topic is longer than the packet, or no UTF-8.
        &[0x30, 3, 0xff, 0xff, 0],
        &[0x30, 6, 0, 2, 0xff, 0xfe, 0, 0],
        // QoS 2, QoS 3, PUBREL, PINGREQ from a server.
        &[0x34, 7, 0, 1, b'a', 0, 1, 0, b'x'],
        &[0x36, 7, 0, 1, b'a', 0, 1, 0, b'x'],
        &[0x62, 2, 0, 9],
        &[0xc0, 0],
        // A message that never ends.
        &[0x30, 0x7f, 0, 10, b's'],
    ];
    for case in cases {
        run(async |broker| {
            let peer = broker.connected().await;
            peer.publish("swarm/status/").await;
            disturbed(&broker, peer, case).await;
        });
    }
}

#[test]
fn commands_queued_for_a_robot_that_was_away_meet_the_clock() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/status/").await;
        let then = super::harness::EPOCH_MS + broker.clock.now().as_millis();
        broker.refuse_connections(true);
        peer.close();
        broker.sleep(SECOND * 40).await;
        broker.refuse_connections(false);
        peer = broker.peer().await;
        peer.accept(true).await;
        let topic = "swarm/command/robot/sim-0001";
        let drive = command("drive", r#""v":0.2,"w":0.0"#, then, 1);
        peer.deliver(topic, drive.as_bytes());
        peer.deliver(topic, command("stop", "", then, 2).as_bytes());
        let response = peer.publish("swarm/response/").await.json();
        assert_eq!(field(&response, "status"), "expired");
        assert!(
            broker.robot.control_handle().take_order().is_none(),
            "nothing to carry out"
        );
        assert!(
            broker.robot.control_handle().take_halt().is_some(),
            "stop is obeyed however old"
        );
    });
}

proptest! {
    #![proptest_config(crawler_properties::cases(256))]

    #[test]
    fn no_bytes_of_the_broker_make_the_link_panic(
        first in proptest::collection::vec(any::<u8>(), 0..64),
        packets in proptest::collection::vec(
            (any::<u8>(), proptest::collection::vec(any::<u8>(), 0..48)),
            0..6,
        ),
    ) {
        run(async |broker| {
            let peer = broker.peer().await;
            peer.connect().await;
            if !first.is_empty() {
                peer.send(&packet(0x20, &first));
            }
            peer.close();
            let peer = broker.connected().await;
            for (kind, body) in &packets {
                peer.send(&packet(*kind, body));
            }
            broker.sleep(SECOND * 12).await;
            assert!(broker.clock.now() > Instant::BOOT);
        });
    }
}
