//! Cells are asked for while the behaviour has to know who is near.

use std::collections::BTreeSet;
use std::string::String;

use crawler_hal::Duration;
use crawler_protocol::BehaviourName;

use super::harness::{Broker, run};
use super::peer::Peer;
use super::wire::Cursor;
use crate::link::SUBSCRIBED_WITHIN;
use crate::neighbours::CELLS;

const SUBSCRIBE: u8 = 8;
const UNSUBSCRIBE: u8 = 10;

fn behave(broker: &Broker, behaviour: BehaviourName) {
    let mut snapshot = broker.robot.snapshot();
    snapshot.behaviour = behaviour;
    (snapshot.pose.x, snapshot.pose.y) = (0.5, 0.5);
    broker.robot.control_handle().publish(&snapshot);
}

/// The next request of the robot, SUBSCRIBE or UNSUBSCRIBE: its kind, its identifier, and its filter with
/// the options behind it.
async fn request(peer: &Peer) -> (u8, [u8; 2], String) {
    loop {
        let packet = peer.packet().await.expect("the connection stays open");
        let kind = packet.kind();
        if !matches!(kind, SUBSCRIBE | UNSUBSCRIBE) {
            peer.serve(&packet);
            continue;
        }
        let mut body = Cursor(&packet.body);
        let id = body.short().to_be_bytes();
        body.skip_properties();
        let filter = body.text();
        let options = std::format!("{filter} {:?}", body.0);
        return (kind, id, options);
    }
}

/// Grants as many requests as there are cells around a robot, all of one kind.
async fn requests(peer: &Peer, wanted: u8) -> BTreeSet<String> {
    some_requests(peer, wanted, CELLS).await
}

async fn some_requests(peer: &Peer, wanted: u8, count: usize) -> BTreeSet<String> {
    let mut filters = BTreeSet::new();
    for _ in 0..count {
        let (kind, id, filter) = request(peer).await;
        assert_eq!(kind, wanted, "{filter}");
        let answer = if kind == SUBSCRIBE { 0x90 } else { 0xb0 };
        peer.send(&[answer, 4, id[0], id[1], 0, 0]);
        assert!(filters.insert(filter), "asked twice");
    }
    filters
}

/// A cell and the eight around it, each with `options`.
fn around_the_first(options: &str) -> BTreeSet<String> {
    let steps = -1..=1;
    let cells = steps
        .clone()
        .flat_map(|x| steps.clone().map(move |y| (x, y)));
    cells
        .map(|(x, y)| std::format!("swarm/cell/{x}/{y} {options}"))
        .collect()
}

#[test]
fn whoever_has_to_know_who_is_near_listens_around_itself() {
    for behaviour in [
        BehaviourName::Disperse,
        BehaviourName::Gather,
        BehaviourName::Flock,
        BehaviourName::Formation,
    ] {
        run(async |broker| {
            let peer = broker.connected().await;
            behave(&broker, behaviour);
            // QoS 0, and 0x20 for no retained messages.
            let asked = requests(&peer, SUBSCRIBE).await;
            assert_eq!(asked, around_the_first("[32]"), "{behaviour:?}");
            behave(&broker, BehaviourName::Manual);
            let left = requests(&peer, UNSUBSCRIBE).await;
            assert_eq!(left, around_the_first("[]"), "{behaviour:?}");
        });
    }
}

#[test]
fn whoever_wanders_listens_to_cells_that_are_close() {
    run(async |broker| {
        let peer = broker.connected().await;
        behave(&broker, BehaviourName::Wander);
        let asked = some_requests(&peer, SUBSCRIBE, 4).await;
        let close = ["-1/-1", "-1/0", "0/-1", "0/0"];
        let close = close.map(|cell| std::format!("swarm/cell/{cell} [32]"));
        assert_eq!(asked, BTreeSet::from(close));
        // Ends at a request: a peer has no other answer to it.
        peer.publishes_for(Duration::from_secs(3)).await;
    });
}

#[test]
fn whoever_need_not_know_asks_for_no_cell() {
    run(async |broker| {
        let peer = broker.connected().await;
        behave(&broker, BehaviourName::Manual);
        // Ends at a request: a peer has no other answer to it.
        let all = peer.publishes_for(Duration::from_secs(3)).await;
        assert!(!all.is_empty(), "the session lives");
    });
}

#[test]
fn a_broker_that_refuses_a_cell_is_not_asked_again() {
    run(async |broker| {
        let peer = broker.connected().await;
        behave(&broker, BehaviourName::Flock);
        let (kind, id, filter) = request(&peer).await;
        assert_eq!((kind, filter.as_str()), (SUBSCRIBE, "swarm/cell/0/0 [32]"));
        // 0x87: not authorized.
        peer.send(&[0x90, 4, id[0], id[1], 0, 0x87]);
        let told = peer.publish("swarm/logs/").await;
        assert_eq!(told.json()["event"], "no-neighbours");
        let all = peer.publishes_for(Duration::from_secs(3)).await;
        assert!(!all.is_empty(), "the session lives");
    });
}

#[test]
fn a_broker_that_says_nothing_about_a_cell_is_left() {
    run(async |broker| {
        let peer = broker.connected().await;
        behave(&broker, BehaviourName::Flock);
        request(&peer).await;
        let asked = broker.now();
        peer.publishes_for(SUBSCRIBED_WITHIN + Duration::from_secs(1))
            .await;
        assert!(broker.now() - asked >= SUBSCRIBED_WITHIN, "it waited");
        assert!(broker.now() - asked < SUBSCRIBED_WITHIN + Duration::from_secs(1));
        peer.dropped().await;
    });
}
