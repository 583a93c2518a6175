//! Robots on real sockets in real time, against a broker of a few lines.
#![cfg(feature = "live")]

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use crawler_protocol::{Fleet, PoseFix};
use crawler_sim::run::live::{LiveConfig, LiveError, start};
use crawler_sim::scenario::Scenario;

/// First byte and body of a packet from a robot.
type Packet = (u8, Vec<u8>);

fn packet(stream: &mut TcpStream) -> Option<Packet> {
    let mut byte = [0];
    stream.read_exact(&mut byte).ok()?;
    let first = byte[0];
    let mut len = 0;
    for place in 0..4 {
        stream.read_exact(&mut byte).ok()?;
        len |= usize::from(byte[0] & 0x7F) << (7 * place);
        if byte[0] & 0x80 == 0 {
            break;
        }
    }
    let mut body = vec![0; len];
    stream.read_exact(&mut body).ok()?;
    Some((first, body))
}

/// A message that says it is one hour after the beginning of 2026.
fn time() -> Vec<u8> {
    let (topic, payload) = (b"swarm/time", br#"{"timestamp":1767229200000}"#);
    let mut message = vec![0x30, (3 + topic.len() + payload.len()) as u8, 0, 10];
    message.extend(topic);
    message.push(0);
    message.extend(payload);
    message
}

/// Answers as a broker does, tells the time, and passes on what it hears.
fn serve(mut stream: TcpStream, heard: &Sender<Packet>) {
    while let Some((first, body)) = packet(&mut stream) {
        let answer: Vec<u8> = match first >> 4 {
            1 => vec![0x20, 3, 0, 0, 0],
            // Granted, for one filter at a time.
            8 => {
                let mut answer = vec![0x90, 4, body[0], body[1], 0, 1];
                if body.windows(10).any(|part| part == b"swarm/time") {
                    answer.extend(time());
                }
                answer
            }
            3 if first & 0x06 != 0 => {
                let topic = usize::from(u16::from_be_bytes([body[0], body[1]]));
                vec![0x40, 2, body[2 + topic], body[3 + topic]]
            }
            12 => vec![0xD0, 0],
            _ => Vec::new(),
        };
        if stream.write_all(&answer).is_err() || heard.send((first, body)).is_err() {
            return;
        }
    }
}

fn broker() -> (u16, Receiver<Packet>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let (to, heard) = channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let to = to.clone();
            std::thread::spawn(move || serve(stream, &to));
        }
    });
    (port, heard)
}

fn config(port: u16, robots: u32) -> LiveConfig {
    LiveConfig {
        fleet: Fleet::default(),
        broker_host: "127.0.0.1".to_owned(),
        broker_port: port,
        credentials: None,
        scenario: Scenario::built_in("arena").unwrap().with_robots(robots),
        seed: 1,
        radio_proxy: None,
        authority: None,
    }
}

#[test]
fn robots_connect_report_and_say_goodbye() {
    let (port, heard) = broker();
    let handle = start(config(port, 5)).unwrap();
    assert_eq!(handle.arena().width, 10.0_f32.sqrt());
    let begun = Instant::now();
    while handle.metrics().connected < 5 {
        assert!(
            begun.elapsed() < Duration::from_secs(20),
            "{:?}",
            handle.metrics()
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(2_500));
    let metrics = handle.metrics();
    assert!(metrics.running);
    assert_eq!(metrics.robots, 5);
    assert!(metrics.steps > 100, "{metrics:?}");
    let report = handle.stop(Duration::from_secs(5)).unwrap();
    assert_eq!(
        (report.robots, report.standing, report.connected),
        (5, 5, 5)
    );
    assert!(!handle.metrics().running);
    // Asked again, it says the same.
    assert_eq!(handle.stop(Duration::ZERO).unwrap(), report);
    let mut kinds = [0; 16];
    let mut fixes = [0; 5];
    while let Ok((first, body)) = heard.recv_timeout(Duration::from_millis(500)) {
        kinds[usize::from(first >> 4)] += 1;
        if first >> 4 == 3
            && let Some(rest) = body[2..].strip_prefix(b"swarm/pose/sim-000")
        {
            // Topic, no properties, payload.
            let fix = PoseFix::from_json(&rest[2..]).unwrap();
            let hour = 1_767_229_200_000;
            assert!((hour..hour + 60_000).contains(&fix.timestamp), "{fix:?}");
            assert_eq!(first, 0x30, "QoS 0, not retained");
            fixes[usize::from(rest[0] - b'1')] += 1;
        }
        if first >> 4 == 14 {
            // With the will, and the session ends.
            assert_eq!(body, [0x04, 5, 0x11, 0, 0, 0, 0]);
        }
    }
    // Five robots and the tracker.
    assert_eq!(kinds[1], 6, "one CONNECT each");
    // Whoever is stopped in the middle of a packet can say nothing.
    assert!((4..=6).contains(&kinds[14]), "{} DISCONNECTs", kinds[14]);
    assert!(fixes.iter().all(|n| (3..40).contains(n)), "{fixes:?}");
    assert!(kinds[3] > 50, "telemetry of five robots for two seconds");
}

#[test]
fn an_absent_broker_is_no_error_and_stopping_is_still_bounded() {
    // Bound and dropped: nobody listens there.
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let handle = start(config(port, 3)).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(handle.metrics().connected, 0);
    let begun = Instant::now();
    let report = handle.stop(Duration::from_secs(5)).unwrap();
    assert_eq!((report.standing, report.connected), (3, 0));
    assert!(begun.elapsed() < Duration::from_secs(5));
}

#[test]
fn mistakes_are_told_at_the_start() {
    let mut wrong = config(1883, 1);
    wrong.broker_host = "no such host".to_owned();
    assert!(matches!(start(wrong), Err(LiveError::Host(..))));
    let mut wrong = config(1883, 1);
    wrong.scenario = Scenario::built_in("empty").unwrap().with_robots(5_000);
    assert!(matches!(start(wrong), Err(LiveError::Simulation(_))));
}

#[test]
fn robots_of_a_scenario_with_a_radio_are_heard_through_it() {
    let (port, heard) = broker();
    let mut config = config(port, 5);
    config.scenario = Scenario::parse(
        "name = \"hall\"\nrobots = 5\n\
         [[radio.access_points]]\nx = 0.0\ny = 0.0\n[parameters.radio]\nlatency_ms = 10.0",
    )
    .unwrap();
    let handle = start(config).unwrap();
    let radio = handle.radio().unwrap();
    let begun = Instant::now();
    while handle.metrics().connected < 5 {
        let waited = begun.elapsed();
        assert!(waited < Duration::from_secs(20), "{:?}", handle.metrics());
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(radio.metrics().connections, 5, "the tracker has a wire");
    let rssi = radio.signal("sim-0003").borrow().rssi_dbm;
    assert!((-75..-5).contains(&rssi), "{rssi} dBm within two metres");
    // One loses its link, notices, and says nothing more; the others go on.
    radio.cut("sim-0003", crawler_sim::net::lockstep::Cut::Radio);
    while handle.metrics().connected > 4 {
        assert!(begun.elapsed() < Duration::from_secs(40));
        std::thread::sleep(Duration::from_millis(20));
    }
    radio.cut("sim-0003", crawler_sim::net::lockstep::Cut::None);
    while handle.metrics().connected < 5 {
        assert!(begun.elapsed() < Duration::from_mins(1));
        std::thread::sleep(Duration::from_millis(20));
    }
    let report = handle.stop(Duration::from_secs(5)).unwrap();
    assert_eq!((report.robots, report.connected), (5, 5));
    let (mut with_rssi, mut goodbyes) = (0, 0);
    while let Ok((first, body)) = heard.recv_timeout(Duration::from_millis(500)) {
        let text = String::from_utf8_lossy(&body);
        if text.contains("swarm/telemetry/") {
            assert!(text.contains("\"rssi_dbm\":-"), "{text}");
            with_rssi += 1;
        }
        goodbyes += i32::from(first >> 4 == 14);
    }
    assert!(with_rssi > 20, "{with_rssi}");
    // Five robots, and the tracker; one more of the robot that knew that its link was gone. Whoever
    // is stopped in the middle of a packet can say nothing.
    assert!((4..=7).contains(&goodbyes), "{goodbyes} goodbyes");
}
