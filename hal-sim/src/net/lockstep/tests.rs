mod shards;

use std::cell::RefCell;

use crawler_hal::{Instant, LinkMonitor, LinkState, Network, with_deadline};
use embedded_io_async::{Read, Write};

use super::*;
use crate::sched::Scheduler;

fn ms(value: u64) -> Instant {
    Instant::from_millis(value)
}

/// A network at work, and its scheduler.
fn start(model: LinkModel) -> (Scheduler, VirtualNetwork) {
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    let network = VirtualNetwork::new(model, 1, &clock);
    sched.spawn(run(network.clone()));
    network.record(1_000);
    (sched, network)
}

/// The network at work, as a simulation lets it: nothing is due sooner than a tenth of a
/// millisecond after it was set in motion.
async fn run(network: VirtualNetwork) {
    loop {
        network.process();
        if network.now().is_multiple_of(10_000) {
            network.settle();
        }
        let soon = (network.now() / 100 + 1) * 100;
        let next = Instant::from_micros(network.next_due().min(soon));
        network.clock.sleep_until(next).await;
    }
}

fn frame(first: u8, body: &[u8]) -> Vec<u8> {
    let mut out = vec![first, body.len() as u8];
    assert!(body.len() < 128);
    out.extend_from_slice(body);
    out
}

/// CONNECT with a keep-alive of ten seconds, a session of a minute, and a retained will.
fn connect(client: &str, clean: bool) -> Vec<u8> {
    let mut body = b"\x00\x04MQTT\x05".to_vec();
    body.push(0x2C | u8::from(clean) << 1);
    body.extend_from_slice(&[0, 10, 5, 0x11, 0, 0, 0, 60]);
    body.extend_from_slice(&[0, client.len() as u8]);
    body.extend_from_slice(client.as_bytes());
    body.extend_from_slice(b"\x00\x00\x04will\x00\x04gone");
    frame(0x10, &body)
}

fn subscribe(filter: &str) -> Vec<u8> {
    let mut body = vec![0, 7, 0, 0, filter.len() as u8];
    body.extend_from_slice(filter.as_bytes());
    body.push(1);
    frame(0x82, &body)
}

fn publish(topic: &str, id: u8, duplicate: bool, payload: &[u8]) -> Vec<u8> {
    let mut body = vec![0, topic.len() as u8];
    body.extend_from_slice(topic.as_bytes());
    body.extend_from_slice(&[0, id, 0]);
    body.extend_from_slice(payload);
    frame(if duplicate { 0x3A } else { 0x32 }, &body)
}

async fn send(stream: &mut LockstepStream, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let written = stream.write(bytes).await.unwrap();
        bytes = &bytes[written..];
    }
}

/// Whatever arrives within `span`, and whether the stream ended.
async fn hear(
    network: &VirtualNetwork,
    stream: &mut LockstepStream,
    span: Duration,
) -> (Vec<u8>, bool) {
    let deadline = network.clock.now() + span;
    let mut heard = Vec::new();
    let mut buf = [0; 64];
    loop {
        match with_deadline(&network.clock, deadline, stream.read(&mut buf)).await {
            Ok(Ok(0) | Err(ConnectionReset)) => return (heard, true),
            Ok(Ok(taken)) => heard.extend_from_slice(&buf[..taken]),
            Err(_) => return (heard, false),
        }
    }
}

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn a_session_subscribes_publishes_and_is_acknowledged() {
    let (mut sched, network) = start(LinkModel::default());
    let mut interface = network.rejoin(network.add_link());
    let work = async {
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", true)).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert_eq!(heard, [0x20, 3, 0, 0, 0]);
        send(&mut stream, &subscribe("x/+")).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert_eq!(heard, [0x90, 4, 0, 7, 0, 1]);
        send(&mut stream, &publish("x/y", 9, false, b"hello")).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        // The acknowledgement, and with the next step the message under the broker's own number.
        assert_eq!(heard[..4], [0x40, 2, 0, 9]);
        assert_eq!(heard[4..], *b"\x32\x0d\x00\x03x/y\x00\x01\x00hello");
        send(&mut stream, &[0x40, 2, 0, 1]).await;
        send(&mut stream, &[0xC0, 0]).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert_eq!(heard, [0xD0, 0]);
        send(&mut stream, &[0xE0, 0]).await;
        assert_eq!(
            hear(&network, &mut stream, SECOND).await,
            (Vec::new(), true)
        );
    };
    sched.block_on(work, ms(60_000)).unwrap();
    let record = network.take_record();
    // Left politely: no will.
    assert_eq!(record.len(), 1);
    assert_eq!(
        (record[0].topic.as_str(), record[0].origin),
        ("x/y", Origin::Client)
    );
    assert_eq!(network.connected(), 0);
    assert_eq!(network.take_faults(), []);
}

#[test]
fn a_client_that_vanishes_leaves_its_will_and_its_session() {
    let (mut sched, network) = start(LinkModel::default());
    let mut interface = network.rejoin(network.add_link());
    let work = async {
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", true)).await;
        send(&mut stream, &subscribe("command")).await;
        send(&mut stream, &publish("x", 5, false, b"1")).await;
        hear(&network, &mut stream, SECOND).await;
        drop(stream);
        network.clock.sleep(SECOND).await;
        let record = network.take_record();
        assert_eq!(record.len(), 2);
        assert_eq!(
            (record[1].topic.as_str(), record[1].origin),
            ("will", Origin::Will)
        );
        // Sent while it is away.
        network.publish("command", b"queued", true, false);
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", false)).await;
        send(&mut stream, &publish("x", 5, true, b"1")).await;
        send(&mut stream, &publish("x", 5, true, b"2")).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert_eq!(heard[..5], [0x20, 3, 1, 0, 0]);
        assert!(heard.windows(6).any(|window| window == b"queued"));
        let origins: Vec<_> = network.take_record().iter().map(|p| p.origin).collect();
        assert_eq!(origins, [Origin::Repeated, Origin::Client]);
        // Not acknowledged, so it comes again, marked as repeated.
        drop(stream);
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", false)).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert_eq!(heard[5] & 0x08, 0x08);
        assert!(heard.windows(6).any(|window| window == b"queued"));
        // A retained message waits for who subscribes later; the will was one.
        send(&mut stream, &subscribe("will")).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert!(heard.windows(4).any(|window| window == b"gone"));
        drop(stream);
        network.clock.sleep(SECOND * 61).await;
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", false)).await;
        let (heard, _) = hear(&network, &mut stream, SECOND).await;
        assert_eq!(heard, [0x20, 3, 0, 0, 0], "the session has expired");
    };
    sched.block_on(work, ms(200_000)).unwrap();
}

#[test]
fn silence_costs_the_connection() {
    let (mut sched, network) = start(LinkModel::default());
    let mut interface = network.rejoin(network.add_link());
    let work = async {
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", true)).await;
        let (heard, ended) = hear(&network, &mut stream, SECOND * 20).await;
        assert_eq!(heard[5..], [0xE0, 2, 0x8D, 0]);
        assert!(ended);
        let lost = network.take_record();
        assert_eq!(lost[0].origin, Origin::Will);
        // Fifteen seconds from the last byte.
        let at = lost[0].at.as_millis();
        assert!((15_000..15_050).contains(&at), "{at}");
    };
    sched.block_on(work, ms(60_000)).unwrap();
    assert_eq!(
        network.take_faults(),
        [(Rc::from("a"), PeerFault::KeepAlive)]
    );
}

#[test]
fn what_is_no_mqtt_is_named_and_closed() {
    for (bytes, fault) in [
        (vec![0xC0, 0], PeerFault::Order),
        (
            vec![0xF0, 0],
            PeerFault::Packet(PacketError::Unsupported(0xF0)),
        ),
        (
            vec![0x10, 0xFF, 0xFF, 0xFF, 0xFF],
            PeerFault::Packet(PacketError::Malformed),
        ),
        (
            [connect("a", true), connect("a", true)].concat(),
            PeerFault::Order,
        ),
    ] {
        let (mut sched, network) = start(LinkModel::default());
        let mut interface = network.rejoin(network.add_link());
        let work = async {
            let mut stream = interface.connect("broker", 1883).await.unwrap();
            send(&mut stream, &bytes).await;
            assert!(hear(&network, &mut stream, SECOND).await.1, "{bytes:?}");
            assert_eq!(stream.write(b"x").await, Err(ConnectionReset));
        };
        sched.block_on(work, ms(60_000)).unwrap();
        let faults = network.take_faults();
        assert_eq!(faults.len(), 1);
        assert_eq!(faults[0].1, fault);
    }
}

#[test]
fn bytes_arrive_in_order_through_loss_jitter_and_partitions() {
    let model = LinkModel {
        loss: 0.3,
        jitter_ms: 50.0,
        ..LinkModel::default()
    };
    let (mut sched, network) = start(model);
    let mut interface = network.rejoin(network.add_link());
    let link = interface.link();
    let times: Rc<RefCell<Vec<u64>>> = Rc::default();
    let work = async {
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", true)).await;
        for number in 0..100_u8 {
            if number == 50 {
                network.cut(link, Cut::Silent);
            }
            send(&mut stream, &publish("x", number + 1, false, &[number])).await;
            network.clock.sleep(Duration::from_millis(5)).await;
        }
        times.borrow_mut().push(network.now());
        network.clock.sleep(SECOND * 5).await;
        network.cut(link, Cut::None);
        hear(&network, &mut stream, SECOND * 9).await;
    };
    sched.block_on(work, ms(60_000)).unwrap();
    let record = network.take_record();
    let numbers: Vec<u8> = record.iter().map(|p| p.payload[0]).collect();
    assert_eq!(numbers, (0..100).collect::<Vec<_>>());
    let cut = times.borrow()[0];
    let held = record
        .iter()
        .filter(|p| p.at.as_micros() > cut + 4_900_000)
        .count();
    assert!(
        held >= 50,
        "only {held} waited for the end of the partition"
    );
}

#[test]
fn a_sender_whose_link_is_cut_waits_instead_of_filling_memory() {
    let (mut sched, network) = start(LinkModel::default());
    let mut interface = network.rejoin(network.add_link());
    let link = interface.link();
    let work = async {
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", true)).await;
        network.cut(link, Cut::Silent);
        let endless = async {
            loop {
                send(&mut stream, &[0xC0, 0]).await;
            }
        };
        let deadline = network.clock.now() + SECOND;
        let outcome: Result<(), _> = with_deadline(&network.clock, deadline, endless).await;
        assert!(outcome.is_err());
    };
    sched.block_on(work, ms(60_000)).unwrap();
    let state = network.state.borrow();
    let under_way: usize = state
        .connections
        .iter()
        .flatten()
        .map(|connection| connection.up.len())
        .sum();
    assert!(under_way <= SEND_BUFFER);
}

#[test]
fn connections_to_a_cut_link_open_when_it_heals() {
    let (mut sched, network) = start(LinkModel::default());
    let mut interface = network.rejoin(network.add_link());
    let link = interface.link();
    network.cut(link, Cut::Radio);
    assert_eq!(interface.monitor().state(), LinkState::Down);
    let work = async {
        let joined = with_deadline(&network.clock, ms(1_000), interface.join()).await;
        assert!(joined.is_err());
        network.cut(link, Cut::None);
        interface.join().await.unwrap();
        interface.connect("broker", 1883).await.unwrap();
        let spent = network.clock.now().as_millis();
        assert!((1_004..=1_010).contains(&spent), "{spent} ms");
    };
    sched.block_on(work, ms(60_000)).unwrap();
}

#[test]
fn link_models_that_cannot_be_are_refused() {
    for model in [
        LinkModel {
            latency_ms: 0.0,
            ..LinkModel::default()
        },
        LinkModel {
            latency_ms: f32::NAN,
            ..LinkModel::default()
        },
        LinkModel {
            jitter_ms: -1.0,
            ..LinkModel::default()
        },
        LinkModel {
            loss: 1.0,
            ..LinkModel::default()
        },
        LinkModel {
            retransmit_ms: f32::INFINITY,
            ..LinkModel::default()
        },
    ] {
        assert!(model.validate().is_err(), "{model:?}");
    }
    assert_eq!(LinkModel::default().validate(), Ok(()));
}
