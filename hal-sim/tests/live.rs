//! Robots on real sockets in real time, against a broker of a few lines.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use crawler_protocol::{Fleet, PoseFix};
use crawler_sim::live::{LiveConfig, LiveError, LiveHandle, LiveMetrics, start};
use crawler_sim::scenario::Scenario;

/// For anything that has to happen, on the slowest machine.
const LIMIT: Duration = Duration::from_mins(2);

/// What the broker heard of a robot.
#[derive(Debug)]
enum Heard {
    /// First byte and body of a packet.
    Packet(u8, Vec<u8>),
    /// Its connection ended, having said the last packet whole or not.
    End { whole: bool },
}

/// The next packet; at the end, whether the last one was whole.
fn packet(stream: &mut TcpStream) -> Result<(u8, Vec<u8>), bool> {
    let mut byte = [0];
    stream.read_exact(&mut byte).map_err(|_| true)?;
    let first = byte[0];
    let mut len = 0;
    for place in 0..4 {
        stream.read_exact(&mut byte).map_err(|_| false)?;
        len |= usize::from(byte[0] & 0x7F) << (7 * place);
        if byte[0] & 0x80 == 0 {
            break;
        }
    }
    let mut body = vec![0; len];
    stream.read_exact(&mut body).map_err(|_| false)?;
    Ok((first, body))
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
fn serve(mut stream: TcpStream, heard: &Sender<Heard>) {
    let whole = loop {
        let (first, body) = match packet(&mut stream) {
            Ok(packet) => packet,
            Err(whole) => break whole,
        };
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
        // Who is gone may have said more than it waited to be answered.
        let _ = stream.write_all(&answer);
        if heard.send(Heard::Packet(first, body)).is_err() {
            return;
        }
    };
    let _ = heard.send(Heard::End { whole });
}

fn broker() -> (u16, Receiver<Heard>) {
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

/// What was heard so far.
#[derive(Debug, Default)]
struct Book {
    /// Packets by their type.
    kinds: [u32; 16],
    /// Of each robot, when the tracker saw it, in milliseconds.
    fixes: [Vec<u64>; 5],
    /// Telemetry of robots, with the strength of their signal in it or not.
    telemetry: [u32; 2],
    /// Connections that ended, with the last packet whole or not.
    ends: [u32; 2],
}

impl Book {
    fn write(&mut self, heard: Heard) {
        let (first, body) = match heard {
            Heard::Packet(first, body) => (first, body),
            Heard::End { whole } => {
                self.ends[usize::from(whole)] += 1;
                return;
            }
        };
        self.kinds[usize::from(first >> 4)] += 1;
        if first >> 4 == 3
            && let Some(rest) = body[2..].strip_prefix(b"swarm/pose/sim-000")
        {
            // Topic, no properties, payload.
            let fix = PoseFix::from_json(&rest[2..]).unwrap();
            assert_eq!(first, 0x30, "QoS 0, not retained");
            self.fixes[usize::from(rest[0] - b'1')].push(fix.timestamp);
        }
        let text = String::from_utf8_lossy(&body);
        if text.contains("swarm/telemetry/") {
            self.telemetry[usize::from(text.contains("\"rssi_dbm\":-"))] += 1;
        }
        if first >> 4 == 14 {
            // With the will, and the session ends.
            assert_eq!(body, [0x04, 5, 0x11, 0, 0, 0, 0]);
        }
    }

    /// Writes down what is heard until it is as it should become.
    fn listen(&mut self, heard: &Receiver<Heard>, what: &str, reached: impl Fn(&Self) -> bool) {
        let begun = Instant::now();
        while !reached(self) {
            let left = LIMIT.saturating_sub(begun.elapsed());
            match heard.recv_timeout(left) {
                Ok(news) => self.write(news),
                Err(error) => panic!("{what}: {error}; {self:?}"),
            }
        }
    }
}

/// Waits until a world is as it should become.
fn until(handle: &LiveHandle, what: &str, reached: impl Fn(&LiveMetrics) -> bool) -> LiveMetrics {
    let begun = Instant::now();
    loop {
        let metrics = handle.metrics();
        if reached(&metrics) {
            return metrics;
        }
        assert!(begun.elapsed() < LIMIT, "{what}: {metrics:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn config(port: u16, robots: u32) -> LiveConfig {
    LiveConfig {
        fleet: Fleet::default(),
        broker_host: "127.0.0.1".to_owned(),
        broker_port: port,
        credentials: None,
        scenario: Scenario::built_in("arena").unwrap().with_robots(robots),
        seed: 1,
        release_keys: None,
        radio_proxy: None,
        other_ends: 1,
        authority: None,
    }
}

#[test]
fn robots_connect_report_and_say_goodbye() {
    let (port, heard) = broker();
    let handle = start(config(port, 5)).unwrap();
    assert_eq!(handle.arena().width, 10.0_f32.sqrt());
    until(&handle, "all connect", |metrics| metrics.connected == 5);
    let mut book = Book::default();
    book.listen(&heard, "the camera sees all, and they report", |book| {
        let seen = book.fixes.iter().all(|fixes| fixes.len() >= 4);
        seen && book.telemetry.iter().sum::<u32>() > 50
    });
    let metrics = until(&handle, "time passes", |metrics| metrics.steps > 100);
    assert!(metrics.running);
    assert_eq!(metrics.robots, 5);
    let report = handle.stop(LIMIT).unwrap();
    assert_eq!(
        (report.robots, report.standing, report.connected),
        (5, 5, 5)
    );
    assert!(!handle.metrics().running);
    // Asked again, it says the same.
    assert_eq!(handle.stop(Duration::ZERO).unwrap(), report);
    // Five robots and the tracker.
    book.listen(&heard, "all connections end", |book| {
        book.ends.iter().sum::<u32>() == 6
    });
    assert_eq!(book.kinds[1], 6, "one CONNECT each");
    // Whoever is stopped in the middle of a packet can say nothing.
    assert_eq!(book.kinds[14], book.ends[1], "{book:?}");
    let hour = 1_767_229_200_000;
    for fixes in &book.fixes {
        let span = hour..hour + LIMIT.as_millis() as u64 * 5;
        assert!(fixes.iter().all(|at| span.contains(at)), "{fixes:?}");
        // Twice a second by the world's clock; what a busy machine leaves out is missing.
        let apart = fixes.windows(2).map(|two| two[1] - two[0]);
        assert!(apart.min() >= Some(480), "{fixes:?}");
    }
}

#[test]
fn an_absent_broker_is_no_error_and_stopping_is_still_bounded() {
    let (_kept, address) = crate::common::port::refusing();
    let handle = start(config(address.port(), 3)).unwrap();
    // Time enough for all to boot and to be refused.
    let metrics = until(&handle, "time passes", |metrics| metrics.steps > 100);
    assert_eq!(metrics.connected, 0);
    let report = handle.stop(LIMIT).unwrap();
    assert_eq!((report.standing, report.connected), (3, 0));
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
    until(&handle, "all connect", |metrics| metrics.connected == 5);
    assert_eq!(radio.metrics().connections, 5, "the tracker has a wire");
    let rssi = radio.signal("sim-0003").borrow().rssi_dbm;
    assert!((-75..-5).contains(&rssi), "{rssi} dBm within two metres");
    let mut book = Book::default();
    book.listen(&heard, "they report", |book| book.telemetry[1] > 20);
    // One loses its link, notices, and says nothing more; the others go on.
    radio.cut("sim-0003", crawler_sim::net::lockstep::Cut::Radio);
    until(&handle, "one is cut off", |metrics| metrics.connected == 4);
    radio.cut("sim-0003", crawler_sim::net::lockstep::Cut::None);
    until(&handle, "it comes back", |metrics| metrics.connected == 5);
    let report = handle.stop(LIMIT).unwrap();
    assert_eq!((report.robots, report.connected), (5, 5));
    // Five robots, one of them twice, and the tracker.
    book.listen(&heard, "all connections end", |book| {
        book.ends.iter().sum::<u32>() == 7
    });
    assert_eq!(book.kinds[1], 7, "{book:?}");
    assert_eq!(book.telemetry[0], 0, "all say how strong their signal is");
    // The one whose link was gone says it as well, once it can. Whoever is stopped in the middle of
    // a packet can say nothing, and what is still in the air half a second later is lost.
    assert!((1..=7).contains(&book.kinds[14]), "{book:?}");
}
