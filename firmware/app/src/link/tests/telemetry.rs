//! Telemetry in every way it can be written, and several samples at a time.

use std::vec::Vec;

use crawler_hal::Duration;
use crawler_protocol::{
    MAX_MESSAGE, ParameterValue, ParameterValues, RobotState, Telemetry, TelemetryEncoding,
};

use super::harness::{Broker, EPOCH_MS, run};
use super::peer::Peer;
use super::wire::{Cursor, Publish};
use crate::link::BATCH_AGE;

/// One message of telemetry, and when it arrived by the robot's clock.
struct Message {
    how: Option<TelemetryEncoding>,
    samples: Vec<Telemetry>,
    /// Unix time of its arrival.
    at: u64,
}

fn adjust(broker: &Broker, values: &[(&str, f32)]) {
    let values: ParameterValues = values
        .iter()
        .map(|(name, value)| {
            let name = (*name).try_into().expect("short");
            (name, ParameterValue::Number(*value))
        })
        .collect();
    broker.robot.adjust(&values).expect("within range");
}

fn content_type(publish: &Publish) -> Option<std::string::String> {
    let mut properties = Cursor(&publish.properties);
    if properties.0.is_empty() {
        return None;
    }
    assert_eq!(properties.byte(), 3, "a content type, and nothing else");
    let text = properties.text();
    assert!(properties.0.is_empty());
    Some(text)
}

fn open(broker: &Broker, publish: &Publish) -> Message {
    assert_eq!((publish.qos, publish.retained), (0, false));
    assert!(publish.payload.len() <= MAX_MESSAGE);
    let text = content_type(publish);
    let how = TelemetryEncoding::of(text.as_deref()).expect("a content type of telemetry");
    let samples: Result<Vec<_>, _> = how.samples(&publish.payload).collect();
    Message {
        how: text.map(|_| how),
        samples: samples.expect("samples"),
        at: EPOCH_MS + broker.now().as_millis(),
    }
}

/// The next `count` messages of telemetry.
async fn messages(broker: &Broker, peer: &Peer, count: usize) -> Vec<Message> {
    let mut all = Vec::new();
    while all.len() < count {
        let publish = peer.publish("swarm/telemetry/").await;
        all.push(open(broker, &publish));
    }
    all
}

/// All messages of telemetry until `span` has passed.
async fn messages_for(broker: &Broker, peer: &Peer, span: Duration) -> Vec<Message> {
    let all = peer.publishes_for(span).await;
    let telemetry = all
        .iter()
        .filter(|p| p.topic.starts_with("swarm/telemetry/"));
    telemetry.map(|publish| open(broker, publish)).collect()
}

/// Every number once and in its order, none older than it may be.
fn check(messages: &[Message]) {
    let samples: Vec<_> = messages.iter().flat_map(|m| &m.samples).collect();
    for pair in samples.windows(2) {
        assert_eq!(pair[1].seq, pair[0].seq + 1);
        assert!(pair[1].timestamp > pair[0].timestamp);
    }
    for message in messages {
        let age = message.at - message.samples[0].timestamp;
        assert!(age < BATCH_AGE.as_millis(), "{age} ms old");
    }
}

fn set_state(broker: &Broker, state: RobotState) {
    let mut snapshot = broker.robot.snapshot();
    snapshot.state = state;
    broker.robot.control_handle().publish(&snapshot);
}

#[test]
fn cbor_is_sent_sample_by_sample() {
    run(async |broker| {
        adjust(&broker, &[("telemetry_format", 1.0)]);
        let peer = broker.connected().await;
        let all = messages(&broker, &peer, 25).await;
        check(&all[1..]);
        for message in &all {
            assert_eq!(message.how, Some(TelemetryEncoding::Cbor));
            assert_eq!(message.samples.len(), 1);
        }
        assert_eq!(all[24].at - all[14].at, 2_000, "five times a second");
    });
}

#[test]
fn samples_travel_together() {
    run(async |broker| {
        adjust(
            &broker,
            &[("telemetry_format", 1.0), ("telemetry_batch", 5.0)],
        );
        let peer = broker.connected().await;
        // The first go alone: the robot is new, and does not know the time yet.
        messages(&broker, &peer, 3).await;
        let all = messages(&broker, &peer, 10).await;
        check(&all);
        for message in &all {
            assert_eq!(message.how, Some(TelemetryEncoding::CborSeq));
            assert_eq!(message.samples.len(), 5);
            let times: Vec<_> = message.samples.iter().map(|s| s.timestamp).collect();
            assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 200));
            assert_eq!(message.at, times[4], "sent as soon as there are five");
        }
    });
}

#[test]
fn a_message_takes_what_fits() {
    run(async |broker| {
        adjust(&broker, &[("telemetry_batch", 10.0)]);
        let peer = broker.connected().await;
        messages(&broker, &peer, 3).await;
        let all = messages(&broker, &peer, 10).await;
        check(&all);
        for message in &all {
            assert_eq!(message.how, Some(TelemetryEncoding::JsonSeq));
            assert!((3..=5).contains(&message.samples.len()));
        }
    });
}

#[test]
fn no_sample_waits_for_two_seconds() {
    for hz in [0.4, 0.9, 1.0, 1.1, 4.0, 20.0] {
        run(async |broker| {
            let values = [
                ("telemetry_format", 1.0),
                ("telemetry_batch", 10.0),
                ("telemetry_hz", hz),
            ];
            adjust(&broker, &values);
            let peer = broker.connected().await;
            messages(&broker, &peer, 3).await;
            let all = messages(&broker, &peer, 20).await;
            check(&all);
            let most = all.iter().map(|message| message.samples.len()).max();
            let expected = ((2.0 * hz).ceil() as usize).clamp(1, 10);
            assert_eq!(most, Some(expected), "{hz} Hz");
        });
    }
}

#[test]
fn a_change_of_state_does_not_wait() {
    run(async |broker| {
        adjust(
            &broker,
            &[("telemetry_format", 1.0), ("telemetry_batch", 10.0)],
        );
        set_state(&broker, RobotState::Idle);
        let peer = broker.connected().await;
        messages(&broker, &peer, 4).await;
        for state in [RobotState::Moving, RobotState::Error, RobotState::Idle] {
            messages_for(&broker, &peer, Duration::from_millis(700)).await;
            set_state(&broker, state);
            let changed = EPOCH_MS + broker.now().as_millis();
            let message = messages(&broker, &peer, 1).await.remove(0);
            let last = message.samples.last().expect("samples");
            assert_eq!(last.state, state);
            assert!(message.at - changed <= 200, "within one period");
        }
    });
}

#[test]
fn other_parameters_hold_from_the_next_sample_on() {
    run(async |broker| {
        adjust(
            &broker,
            &[("telemetry_format", 1.0), ("telemetry_batch", 10.0)],
        );
        let peer = broker.connected().await;
        let mut all = messages(&broker, &peer, 5).await;
        let steps = [
            [("telemetry_format", 0.0), ("telemetry_batch", 10.0)],
            [("telemetry_format", 0.0), ("telemetry_batch", 1.0)],
            [("telemetry_format", 1.0), ("telemetry_batch", 1.0)],
            [("telemetry_format", 1.0), ("telemetry_batch", 4.0)],
        ];
        let expected = [
            Some(TelemetryEncoding::JsonSeq),
            None,
            Some(TelemetryEncoding::Cbor),
            Some(TelemetryEncoding::CborSeq),
        ];
        for (values, how) in steps.iter().zip(expected) {
            // In the middle of a batch.
            all.extend(messages_for(&broker, &peer, Duration::from_millis(500)).await);
            adjust(&broker, values);
            all.extend(messages(&broker, &peer, 4).await);
            assert_eq!(all.last().expect("messages").how, how);
        }
        // Nothing was lost on the way.
        let seqs: Vec<_> = all.iter().flat_map(|m| &m.samples).map(|s| s.seq).collect();
        assert!(
            seqs.windows(2).all(|pair| pair[1] == pair[0] + 1),
            "{seqs:?}"
        );
    });
}

#[test]
fn what_waited_when_the_link_was_lost_is_not_sent_later() {
    run(async |broker| {
        adjust(
            &broker,
            &[("telemetry_format", 1.0), ("telemetry_batch", 10.0)],
        );
        let peer = broker.connected().await;
        let mut before = messages(&broker, &peer, 5).await;
        before.extend(messages_for(&broker, &peer, Duration::from_millis(900)).await);
        peer.close();
        peer.dropped().await;
        let mut peer = broker.peer().await;
        let again = EPOCH_MS + broker.now().as_millis();
        peer.accept(true).await;
        let after = messages(&broker, &peer, 5).await;
        check(&after);
        let first = &after[0].samples;
        assert_eq!(first.len(), 1, "the first of a connection does not wait");
        assert!(first[0].timestamp >= again);
        let last = before.last().expect("messages");
        let last = last.samples.last().expect("samples");
        assert!(first[0].seq > last.seq + 1, "some were lost with the link");
    });
}
