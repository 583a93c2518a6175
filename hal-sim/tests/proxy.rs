//! The bad network for real byte streams, on loopback and in real time.
//!
//! What a radio delays, carries and shares out is tested in virtual time, beside the code. Here it
//! is only ever said that something comes, and that it does not come too early: a busy machine may
//! be late.

mod ends;

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use crawler_sim::net::lockstep::{Cut, LinkModel};
use crawler_sim::net::proxy::{Proxy, ProxyConfig, ProxyMetrics};
use crawler_sim::net::radio::{AccessPoint, Radio, Setup};
use crawler_sim::world::RadioFigures;
use proptest::prelude::*;

/// For anything that has to come, on the slowest machine.
const LIMIT: Duration = Duration::from_mins(2);

/// A link that costs next to nothing.
const QUICK: LinkModel = LinkModel {
    latency_ms: 0.1,
    jitter_ms: 0.0,
    loss: 0.0,
    retransmit_ms: 5.0,
    rssi_dbm: -55,
};

fn setup(link: LinkModel, radio: Option<Radio>) -> Setup {
    Setup {
        link,
        radio,
        figures: RadioFigures {
            shadowing_db: 0.0,
            fading_db: 0.0,
            contention: 0.0,
            ..RadioFigures::default()
        },
        seed: 1,
    }
}

fn proxy(broker: SocketAddr, setup: Setup) -> Proxy {
    Proxy::start(&ProxyConfig {
        listen: "127.0.0.1:0".parse().unwrap(),
        broker: vec![broker],
        setup,
        most_connections: 300,
    })
    .unwrap()
}

/// Answers every connection by `work`, each on a thread of its own.
fn server(work: impl Fn(TcpStream) + Send + Clone + 'static) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let work = work.clone();
            std::thread::spawn(move || work(stream));
        }
    });
    address
}

fn echo(mut stream: TcpStream) {
    let mut buffer = [0; 4_096];
    while let Ok(len) = stream.read(&mut buffer) {
        if len == 0 || stream.write_all(&buffer[..len]).is_err() {
            return;
        }
    }
}

/// CONNECT of MQTT 5.
fn hello(name: &str) -> Vec<u8> {
    let mut packet = vec![0x10, 13 + name.len() as u8];
    packet.extend(b"\x00\x04MQTT\x05\x02\x00\x0A\x00\x00");
    packet.push(name.len() as u8);
    packet.extend(name.as_bytes());
    packet
}

/// A robot that has said its name, and heard it if the server echoes.
fn robot(proxy: &Proxy, name: &str, echoes: bool) -> TcpStream {
    let mut stream = TcpStream::connect(proxy.address()).unwrap();
    stream.set_nodelay(true).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    let hello = hello(name);
    stream.write_all(&hello).unwrap();
    if echoes {
        let mut heard = vec![0; hello.len()];
        stream.read_exact(&mut heard).unwrap();
        assert_eq!(heard, hello);
    }
    stream
}

/// Says all of `bytes` in pieces, and hears as many.
fn exchange(stream: &TcpStream, bytes: &[u8], piece: usize) -> Vec<u8> {
    let (mut to, mut from) = (stream.try_clone().unwrap(), stream.try_clone().unwrap());
    std::thread::scope(|scope| {
        scope.spawn(move || {
            for part in bytes.chunks(piece) {
                to.write_all(part).unwrap();
            }
        });
        let mut heard = vec![0; bytes.len()];
        from.read_exact(&mut heard).unwrap();
        heard
    })
}

/// Waits until the figures of a proxy are as they should become.
fn until(proxy: &Proxy, what: &str, reached: impl Fn(&ProxyMetrics) -> bool) {
    let begun = Instant::now();
    loop {
        let metrics = proxy.metrics();
        if reached(&metrics) {
            return;
        }
        assert!(begun.elapsed() < LIMIT, "{what}: {metrics:?}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// How many bytes a stream has to read at once, up to four; it is not waited for any.
fn ready(stream: &TcpStream) -> usize {
    stream.set_nonblocking(true).unwrap();
    let peeked = stream.peek(&mut [0; 4]);
    stream.set_nonblocking(false).unwrap();
    match peeked {
        Err(error) if error.kind() == ErrorKind::WouldBlock => 0,
        other => other.unwrap(),
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(12))]

    #[test]
    fn bytes_keep_their_order_and_content(
        latency in 0.1_f32..5.0,
        jitter in 0.0_f32..10.0,
        loss in 0.0_f32..0.3,
        radio: bool,
        piece in 1_usize..3_000,
        pieces in 1_usize..40,
        seed: u8,
    ) {
        let link = LinkModel { latency_ms: latency, jitter_ms: jitter, loss, ..QUICK };
        let proxy = proxy(server(echo), setup(link, radio.then(Radio::default)));
        let stream = robot(&proxy, "r", true);
        let bytes: Vec<u8> = (0..piece * pieces)
            .map(|n| (n as u8).wrapping_mul(31).wrapping_add(seed) ^ (n >> 8) as u8)
            .collect();
        prop_assert_eq!(exchange(&stream, &bytes, piece), bytes);
        drop(stream);
        proxy.stop(LIMIT).unwrap();
    }
}

#[test]
fn no_word_is_early_and_lost_ones_come_later() {
    let link = LinkModel {
        latency_ms: 20.0,
        ..QUICK
    };
    let times = |link| -> Vec<f64> {
        let proxy = proxy(server(echo), setup(link, None));
        let stream = robot(&proxy, "r", true);
        (0..40)
            .map(|n| {
                let begun = Instant::now();
                assert_eq!(exchange(&stream, &[n], 1), [n]);
                begun.elapsed().as_secs_f64()
            })
            .collect()
    };
    let calm = times(link);
    // Both ways.
    assert!(calm.iter().all(|&s| s >= 0.040), "{calm:?}");
    let lossy = times(LinkModel {
        loss: 0.3,
        retransmit_ms: 50.0,
        ..link
    });
    // Seven in ten get through at once, so half of all there and back. Which ones are lost is drawn
    // from the seed.
    let late = lossy.iter().filter(|&&s| s >= 0.089).count();
    assert!(late >= 10, "{late} of 40: {lossy:?}");
}

#[test]
fn a_weak_radio_takes_all_the_time_that_the_bytes_of_all_need() {
    /// What a link at the slowest scheme carries, bytes in a second: 6.5 Mbit/s, segments of 1460
    /// bytes with 90 around them and an acknowledgement of 90, 180 µs around each frame. One
    /// frame in ten is lost and sent again.
    const WEAK_RATE: f64 = 0.9 * 1_460.0 / (2.0 * 180e-6 + (1_460.0 + 180.0) * 8.0 / 6.5e6);
    const BYTES: usize = 60_000;
    let mut setup = setup(QUICK, Some(Radio::default()));
    // Just as strong as it takes.
    setup.link.rssi_dbm = -90;
    setup.figures.noise_db = 2.6;
    let proxy = proxy(server(echo), setup);
    let streams: Vec<TcpStream> = (0..4)
        .map(|n| robot(&proxy, &format!("r{n}"), true))
        .collect();
    let said: Vec<u8> = (0..BYTES).map(|n| (n / 7) as u8).collect();
    let begun = Instant::now();
    std::thread::scope(|scope| {
        for stream in &streams {
            scope.spawn(|| assert_eq!(exchange(stream, &said, 8_192), said));
        }
    });
    let took = begun.elapsed().as_secs_f64();
    // There and back.
    let least = (2 * BYTES * streams.len()) as f64 / WEAK_RATE;
    assert!(took >= 0.9 * least, "{took} s, and not {least} s");
}

#[test]
fn two_hundred_robots_are_served_and_those_beyond_the_limit_are_not() {
    let link = LinkModel {
        latency_ms: 2.0,
        jitter_ms: 3.0,
        loss: 0.01,
        ..QUICK
    };
    let proxy = proxy(server(echo), setup(link, None));
    let streams: Vec<TcpStream> = std::thread::scope(|scope| {
        let proxy = &proxy;
        let all: Vec<_> = (0..4)
            .map(|part| {
                scope.spawn(move || {
                    (0..50)
                        .map(|n| robot(proxy, &format!("r-{part}-{n}"), true))
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        all.into_iter().flat_map(|t| t.join().unwrap()).collect()
    });
    for round in 0..5 {
        for mut stream in &streams {
            stream.write_all(&[round; 200]).unwrap();
        }
        for mut stream in &streams {
            let mut heard = [0; 200];
            stream.read_exact(&mut heard).unwrap();
            assert_eq!(heard, [round; 200]);
        }
    }
    let metrics = proxy.metrics();
    assert_eq!((metrics.connections, metrics.stations), (200, 200));
    assert!(metrics.up_bytes > 200_000 && metrics.down_bytes == metrics.up_bytes);
    // A hundred more fit; who comes then is turned away and the others do not notice.
    let more: Vec<TcpStream> = (0..130)
        .map(|_| TcpStream::connect(proxy.address()).unwrap())
        .collect();
    until(&proxy, "everybody is served or turned away", |metrics| {
        metrics.accepted + metrics.refused == 330
    });
    assert_eq!(proxy.metrics().refused, 30);
    assert_eq!(exchange(&streams[0], &[1, 2, 3], 3), [1, 2, 3]);
    drop(more);
    drop(streams);
    until(&proxy, "all connections end", |metrics| {
        metrics.connections == 0
    });
}

#[test]
fn a_cut_link_holds_everything_until_it_heals_and_the_robot_can_know() {
    let proxy = proxy(server(echo), setup(QUICK, None));
    let mut stream = robot(&proxy, "r", true);
    let other = robot(&proxy, "s", true);
    let signal = proxy.signal("r");
    assert_eq!(signal.borrow().cut, Cut::None);
    proxy.cut("r", Cut::Radio);
    assert_eq!(signal.borrow().cut, Cut::Radio);
    let before = proxy.metrics();
    stream.write_all(b"held").unwrap();
    // Who comes now waits for the link, and says no more than its name.
    let mut late = TcpStream::connect(proxy.address()).unwrap();
    late.set_read_timeout(Some(LIMIT)).unwrap();
    late.write_all(&hello("r")).unwrap();
    until(&proxy, "the proxy has taken the connection", |metrics| {
        metrics.accepted == 3
    });
    // One thread serves all, and what is said later by another one has come and gone.
    for _ in 0..20 {
        assert_eq!(exchange(&other, b"free", 4), b"free");
    }
    let metrics = proxy.metrics();
    assert_eq!(metrics.up_bytes - before.up_bytes, 80, "nothing is held");
    assert_eq!((ready(&stream), ready(&late)), (0, 0));
    let mut heard = [0; 4];
    proxy.cut("r", Cut::None);
    assert_eq!(signal.borrow().cut, Cut::None);
    stream.read_exact(&mut heard).unwrap();
    assert_eq!(&heard, b"held");
    let mut name = vec![0; hello("r").len()];
    late.read_exact(&mut name).unwrap();
    // All at once, robots to come included.
    proxy.cut_all(Cut::Silent);
    assert_eq!(proxy.signal("t").borrow().cut, Cut::Silent);
    proxy.cut_all(Cut::None);
    assert_eq!(exchange(&stream, b"back", 4), b"back");
}

#[test]
fn who_is_in_range_is_heard_and_who_is_not_is_told() {
    let radio = Radio {
        access_points: vec![AccessPoint {
            x: 0.0,
            y: 0.0,
            channel: 1,
            attenuation_db: 40.0,
        }],
        partitions: Vec::new(),
    };
    let proxy = proxy(server(echo), setup(QUICK, Some(radio)));
    proxy.place([
        ("near", (1.0, 0.0)),
        ("far", (30.0, 0.0)),
        ("mad", (f32::NAN, 0.0)),
    ]);
    assert_eq!(proxy.signal("near").borrow().rssi_dbm, -62);
    assert_eq!(proxy.signal("far").borrow().cut, Cut::Radio);
    let near = robot(&proxy, "near", true);
    let mut far = TcpStream::connect(proxy.address()).unwrap();
    far.write_all(&hello("far")).unwrap();
    until(&proxy, "the proxy has taken the connection", |metrics| {
        metrics.accepted == 2
    });
    for _ in 0..20 {
        assert_eq!(exchange(&near, b"x", 1), b"x");
    }
    let said = (hello("near").len() + 20) as u64;
    assert_eq!(proxy.metrics().up_bytes, said, "nothing of the other one");
    assert_eq!(ready(&far), 0);
}
