//! Telling the map.

use std::borrow::ToOwned;
use std::string::String;

use crawler_hal::Duration;
use crawler_protocol::{MapSegment, Reason, ResponseStatus};

use super::harness::{Broker, run};
use super::peer::Peer;
use crate::navigation::{Destination, Navigator, Place, Planned};

const TOPIC: &str = "swarm/map/sim-0001";
const ANSWERS: &str = "swarm/response/robot/";
const GOING: Destination = Destination {
    number: 1,
    at: [2_000, 500],
    bumps: 0,
    speed: 240,
};

/// What the sense activity does after a look.
fn look(broker: &Broker, navigator: Option<&Navigator>) {
    let now = broker.now();
    broker.robot.sense_handle().report_map(navigator, now);
}

async fn segment(peer: &Peer) -> MapSegment {
    let publish = peer.publish("swarm/map/").await;
    assert_eq!((publish.topic.as_str(), publish.qos), (TOPIC, 0));
    assert!(!publish.retained);
    let segment = MapSegment::from_json(&publish.payload).expect("a segment");
    assert!(segment.is_consistent());
    segment
}

async fn answer(peer: &Peer) -> (u64, String, Option<Reason>) {
    let answer = peer.publish(ANSWERS).await.json();
    let reason = answer["reason"].as_str().map(|name| {
        let mut all = Reason::ALL.iter();
        *all.find(|reason| reason.name() == name).expect("a reason")
    });
    let status = answer["status"].as_str().expect("a status").to_owned();
    (answer["seq"].as_u64().expect("a number"), status, reason)
}

/// On its way, with a plan.
fn planned() -> Navigator {
    let mut navigator = Navigator::BLANK;
    let here = Place {
        at: [0, 0],
        heading: [4_096, 0],
    };
    navigator.set_out(here, GOING);
    while !matches!(navigator.plan(), Planned::Guide(_)) {}
    navigator
}

#[test]
fn a_map_goes_out_in_segments_and_the_answer_after_the_last() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        let navigator = planned();
        broker.robot.control_handle().go(Some(GOING));
        peer.command(7, "report_map", "");
        let mut rows = 0;
        while rows < 80 {
            broker.sleep(Duration::from_millis(80)).await;
            look(&broker, Some(&navigator));
            let segment = segment(&peer).await;
            assert_eq!((segment.seq, usize::from(segment.row)), (7, rows));
            assert_eq!((segment.columns, segment.rows), (96, 80));
            assert_eq!(segment.goal, (rows == 0).then_some([2.0, 0.5]));
            assert_eq!(segment.way.is_empty(), rows > 0);
            rows += segment.row_count();
            assert_eq!(segment.is_last(), rows == 80);
        }
        let completed = ResponseStatus::Completed.name().to_owned();
        assert_eq!(answer(&peer).await, (7, completed, None));
        // Nobody has asked for another one.
        look(&broker, Some(&navigator));
        assert!(!broker.robot.map_waits());
    });
}

#[test]
fn a_robot_without_a_map_says_so() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.command(7, "report_map", "");
        broker.sleep(Duration::from_millis(80)).await;
        look(&broker, None);
        let failed = ResponseStatus::Failed.name().to_owned();
        assert_eq!(answer(&peer).await, (7, failed, Some(Reason::NoMap)));
    });
}

#[test]
fn one_map_is_told_at_a_time() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.command(7, "report_map", "");
        peer.command(8, "report_map", "");
        let rejected = ResponseStatus::Rejected.name().to_owned();
        assert_eq!(answer(&peer).await, (8, rejected, Some(Reason::Busy)));
        look(&broker, None);
        let failed = ResponseStatus::Failed.name().to_owned();
        assert_eq!(answer(&peer).await, (7, failed, Some(Reason::NoMap)));
        peer.command(9, "report_map", "");
        broker.sleep(Duration::from_millis(80)).await;
        look(&broker, Some(&Navigator::BLANK));
        assert_eq!(segment(&peer).await.seq, 9);
    });
}

#[test]
fn what_was_not_sent_when_the_link_was_lost_goes_with_the_next_session() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.command(7, "report_map", "");
        broker.sleep(Duration::from_millis(80)).await;
        look(&broker, Some(&Navigator::BLANK));
        assert_eq!(segment(&peer).await.row, 0);
        peer.close();
        look(&broker, Some(&Navigator::BLANK));
        assert!(broker.robot.map_waits());
        let peer = broker.connected().await;
        assert_eq!(segment(&peer).await.row, 16);
    });
}
