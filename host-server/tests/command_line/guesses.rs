//! Strangers who guess passwords, from many addresses, over HTTP and at the broker.

use std::io::{Read as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};

use serde_json::Value;
use tokio::net::TcpSocket;

use crate::LIMIT;
use crate::console::{Place, Server};

/// Guesses under way at a time. More at the broker would be sent away unheard.
const AT_ONCE: u8 = 12;
/// Guesses of each of them. 200 in all cost a server more than a gigabyte that gave each its own memory.
const EACH: u8 = 17;
/// Most that the server may have in memory afterwards.
const MOST_MIB: u64 = 120;

/// A connection from an address that nobody else has.
fn connect(number: u8, turn: u8, to: SocketAddr) -> TcpStream {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let stream = runtime.block_on(async {
        let socket = TcpSocket::new_v4().expect("a socket");
        let from = IpAddr::V4(Ipv4Addr::new(127, 1, number, turn + 1));
        socket.bind(SocketAddr::new(from, 0)).expect("bound");
        let stream = socket.connect(to).await.expect("connected");
        stream.into_std().expect("a stream")
    });
    stream.set_nonblocking(false).expect("blocking");
    stream.set_read_timeout(Some(LIMIT)).expect("a time-out");
    stream
}

/// Whether the password was looked at: it is not where others were before it for too long.
fn guess_over_http(mut stream: TcpStream, user: &str) -> bool {
    let body = format!(r#"{{"user":"{user}","password":"wrong, entirely"}}"#);
    let request = format!(
        "POST /api/v1/session HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    );
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    let busy = answer.starts_with("HTTP/1.1 503 ");
    assert!(busy || answer.starts_with("HTTP/1.1 401 "), "{answer}");
    !busy
}

/// The same.
fn guess_at_broker(mut stream: TcpStream, user: &str) -> bool {
    let text = |text: &str| {
        let mut bytes = u16::try_from(text.len())
            .expect("short")
            .to_be_bytes()
            .to_vec();
        bytes.extend(text.as_bytes());
        bytes
    };
    // MQTT 5, with user name and password, kept alive for 30 s, without properties.
    let mut body = [text("MQTT"), vec![5, 0xc2, 0, 30, 0]].concat();
    body.extend([text(user), text(user), text("wrong, entirely")].concat());
    let mut packet = vec![0x10, u8::try_from(body.len()).expect("short")];
    packet.extend(body);
    stream.write_all(&packet).expect("sent");
    let mut answer = [0; 4];
    stream.read_exact(&mut answer).expect("an answer");
    // CONNACK: bad user name or password, or not authorised for want of time.
    assert!(matches!(answer, [0x20, _, _, 0x86 | 0x87]), "{answer:?}");
    answer[3] == 0x86
}

/// What a process has in memory, in MiB.
#[cfg(target_os = "linux")]
fn resident(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).expect("Linux tells");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kib.expect("a number") / 1024
}

#[cfg(target_os = "linux")]
#[test]
fn wrong_passwords_cost_no_memory_that_stays() {
    let place = Place::with_admin();
    let server = Server::start(&place);
    let addresses = std::fs::read(place.path().join("addresses")).expect("told");
    let addresses: Value = serde_json::from_slice(&addresses).expect("JSON");
    let page = addresses["page"].as_str().expect("an address");
    let (_, http) = page.trim_end_matches('/').rsplit_once(':').expect("a port");
    let local = |port: u16| SocketAddr::from(([127, 0, 0, 1], port));
    let http = local(http.parse().expect("a port"));
    let broker = addresses["robots"]["port"].as_u64().expect("a port");
    let broker = local(u16::try_from(broker).expect("a port"));
    std::thread::scope(|scope| {
        for number in 0..AT_ONCE {
            scope.spawn(move || {
                for turn in 0..EACH {
                    let user = format!("user-{number}-{turn}");
                    let guess = || match turn % 2 {
                        0 => guess_over_http(connect(number, turn, http), &user),
                        _ => guess_at_broker(connect(number, turn, broker), &user),
                    };
                    // Under way again until it was looked at: what is not costs nothing.
                    while !guess() {}
                }
            });
        }
    });
    let resident = resident(server.0.id());
    assert!(resident <= MOST_MIB, "{resident} MiB after the guesses");
    drop(server);
}
