use tokio::io::{DuplexStream, duplex};

use super::*;

/// A publish of one byte on `t`, with a topic alias.
const ALIASED: &[u8] = &[0x30, 8, 0, 1, b't', 3, 0x23, 0, 1, b'x'];
const PING: &[u8] = &[0xc0, 0];
const PINGED: &[u8] = &[0xd0, 0];

struct Ends {
    client: DuplexStream,
    broker: DuplexStream,
    carrying: tokio::task::JoinHandle<End>,
}

fn start(room: usize, packets: bool) -> Ends {
    let (client, ours) = duplex(room);
    let (broker, theirs) = duplex(room);
    Ends {
        client,
        broker,
        carrying: tokio::spawn(carry(ours, theirs, packets, None)),
    }
}

async fn read(stream: &mut DuplexStream, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    stream.read_exact(&mut bytes).await.expect("bytes");
    bytes
}

#[tokio::test(start_paused = true)]
async fn bytes_go_both_ways_until_one_side_ends_it() {
    let mut ends = start(64, true);
    ends.client.write_all(PING).await.expect("room");
    assert_eq!(read(&mut ends.broker, 2).await, PING);
    ends.broker.write_all(PINGED).await.expect("room");
    assert_eq!(read(&mut ends.client, 2).await, PINGED);
    // The client says goodbye and is still told what the broker has to say.
    ends.client.shutdown().await.expect("shut down");
    let mut rest = Vec::new();
    ends.broker.read_to_end(&mut rest).await.expect("the end");
    ends.broker.write_all(PINGED).await.expect("room");
    drop(ends.broker);
    ends.client.read_to_end(&mut rest).await.expect("the end");
    assert_eq!(rest, PINGED);
    assert_eq!(ends.carrying.await.expect("no panic"), End::Closed);
}

#[tokio::test(start_paused = true)]
async fn a_topic_alias_ends_it_with_the_reason_between_two_packets() {
    let mut ends = start(64, true);
    // The broker is in the middle of a packet of six bytes.
    ends.broker.write_all(&[0x30, 4, 0]).await.expect("room");
    assert_eq!(read(&mut ends.client, 3).await, [0x30, 4, 0]);
    ends.client.write_all(ALIASED).await.expect("room");
    ends.client.write_all(PING).await.expect("room");
    let begun = tokio::time::Instant::now();
    tokio::task::yield_now().await;
    ends.broker.write_all(&[1, b't', 0]).await.expect("room");
    ends.broker.write_all(PINGED).await.expect("room");
    let mut rest = Vec::new();
    ends.client.read_to_end(&mut rest).await.expect("the end");
    let told = [&[1, b't', 0][..], ALIAS_INVALID].concat();
    // The packet that had begun is whole. Another may have come before the alias was seen.
    let later = [&[1, b't', 0][..], PINGED, ALIAS_INVALID].concat();
    assert!(rest == told || rest == later, "{rest:?}");
    assert!(begun.elapsed() < LAST_WORDS);
    assert_eq!(ends.carrying.await.expect("no panic"), End::Alias);
    let mut said = Vec::new();
    ends.broker.read_to_end(&mut said).await.expect("the end");
    assert!(!said.ends_with(PING), "nothing behind it: {said:?}");
}

#[tokio::test(start_paused = true)]
async fn clients_before_mqtt_5_have_no_properties() {
    let mut ends = start(64, false);
    ends.client.write_all(ALIASED).await.expect("room");
    assert_eq!(read(&mut ends.broker, ALIASED.len()).await, ALIASED);
}

#[tokio::test(start_paused = true)]
async fn who_says_that_it_goes_is_heard_no_longer() {
    for properties in [true, false] {
        let mut ends = start(64, properties);
        let said = [PING, &[0xe0, 0], PING].concat();
        ends.client.write_all(&said).await.expect("room");
        let mut heard = Vec::new();
        // The client keeps its side open.
        ends.broker.read_to_end(&mut heard).await.expect("the end");
        assert_eq!(heard, [PING, &[0xe0, 0]].concat());
        ends.broker.write_all(PINGED).await.expect("room");
        drop(ends.broker);
        let mut told = Vec::new();
        ends.client.read_to_end(&mut told).await.expect("the end");
        assert_eq!(told, PINGED);
        assert_eq!(ends.carrying.await.expect("no panic"), End::Closed);
    }
}

#[tokio::test(start_paused = true)]
async fn a_client_that_takes_nothing_is_gone() {
    let mut ends = start(8, true);
    let begun = tokio::time::Instant::now();
    let flood = async { while ends.broker.write_all(PINGED).await.is_ok() {} };
    let (end, ()) = tokio::join!(&mut ends.carrying, flood);
    assert_eq!(end.expect("no panic"), End::Closed);
    assert_eq!(begun.elapsed(), STALLED);
}

#[tokio::test(start_paused = true)]
async fn a_client_whose_broker_is_gone_is_not_waited_for() {
    let ends = start(64, true);
    drop(ends.broker);
    assert_eq!(ends.carrying.await.expect("no panic"), End::Closed);
    drop(ends.client);
}
