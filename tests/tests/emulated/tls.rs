//! Robots on the emulated board that speak TLS themselves: with the server's own listener (rustls),
//! and with a broker that nobody here wrote (Mosquitto, OpenSSL).

use crawler_hil::BrokerUrl;
use crawler_tests::{Mosquitto, ReservedPort, Tamper, Terracrawler, TestAuthority, subscribe_with};
use crawler_tls::Authority;

use super::board::Board;
use super::{JOINS, machine};

/// This machine, as an emulated one sees it.
const HOST: &str = "10.0.2.2";

fn pin(authority: &TestAuthority) -> String {
    let key = Authority::of_certificate(authority.der()).expect("a key of P-256");
    format!("authority={key}")
}

fn board(id: &str, port: u16, pin: &str) -> Board {
    Board::start_at(id, BrokerUrl::loopback(port), &[pin])
}

/// Waits until the retained status of the robot says that it is online.
fn is_online(port: u16, ca: &str, id: &str) {
    let topic = format!("swarm/heartbeat/{id}");
    let arguments = ["--cafile", ca];
    let heard = subscribe_with(port, &arguments, &topic, 2, JOINS);
    assert!(!heard.is_empty(), "{id} sends no heartbeat");
}

#[test]
fn a_robot_joins_the_server_over_tls() {
    let _machine = machine();
    let server = Terracrawler::start_encrypted(&["serve", "--tls-names", HOST]);
    let ca = server.authority();
    let pem = std::fs::read_to_string(&ca).expect("the certificate");
    let der = der_of(&pem);
    let pinned = Authority::of_certificate(&der).expect("a key of P-256");
    let robot = board("secure", server.mqtt(), &format!("authority={pinned}"));
    is_online(server.mqtt(), &ca.to_string_lossy(), "secure");
    let line = robot.wait_line("with TLS", JOINS);
    assert!(line.is_some(), "it says so when it starts");
    // A robot that was told of no authority says nothing that the listener understands.
    let plain = Board::start_at("plain", BrokerUrl::loopback(server.mqtt()), &[]);
    let refused = plain.wait_line("link-failed", JOINS);
    assert!(refused.is_some(), "{}", server.log());
}

/// The certificate in a PEM file.
fn der_of(pem: &str) -> Vec<u8> {
    let output = std::process::Command::new("openssl")
        .args(["x509", "-outform", "DER"])
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .and_then(|mut child| {
            use std::io::Write as _;
            child
                .stdin
                .take()
                .expect("piped")
                .write_all(pem.as_bytes())?;
            child.wait_with_output()
        });
    output
        .expect("openssl is missing: cargo xtask setup")
        .stdout
}

#[test]
fn a_broker_that_is_not_the_right_one_is_refused_with_the_reason() {
    let _machine = machine();
    let authority = TestAuthority::new();
    let start = |names: &[&str], until| {
        let port = ReservedPort::new();
        let (certificate, key) = authority.server(names, until);
        let broker = Mosquitto::start_encrypted(port.number(), &certificate, &key);
        (port, broker)
    };
    let pinned = pin(&authority);
    let (right, _right) = start(&[HOST, "127.0.0.1"], 2040);
    let (named, _named) = start(&["127.0.0.1", "broker.lan"], 2040);
    let (old, _old) = start(&[HOST], 2026);
    let boards = [
        ("right", board("right", right.number(), &pinned), None),
        (
            "wrong-name",
            board("wrong-name", named.number(), &pinned),
            Some("name"),
        ),
        (
            "expired",
            board("expired", old.number(), &pinned),
            Some("expired"),
        ),
        (
            "wrong-authority",
            board(
                "wrong-authority",
                right.number(),
                &pin(&TestAuthority::new()),
            ),
            Some("untrusted"),
        ),
    ];
    for (id, board, reason) in &boards {
        let line = match reason {
            Some(reason) => format!("broker not trusted ({reason})"),
            None => continue,
        };
        assert!(board.wait_line(&line, JOINS).is_some(), "{id}: {line}");
        assert!(board.wait_line("broker-untrusted", JOINS).is_some());
    }
    let ca = std::env::temp_dir().join(format!("crawler-ca-{}.pem", std::process::id()));
    std::fs::write(&ca, authority.pem()).expect("a file");
    is_online(right.number(), &ca.to_string_lossy(), "right");
    std::fs::remove_file(ca).expect("our own file");
}

#[test]
fn what_is_tampered_with_on_its_way_ends_the_connection() {
    let _machine = machine();
    let authority = TestAuthority::new();
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let (certificate, key) = authority.server(&[HOST, "127.0.0.1"], 2040);
    let _broker = Mosquitto::start_encrypted(port, &certificate, &key);
    let between = Tamper::start(port);
    let robot = board("watched", between.port(), &pin(&authority));
    let ca = std::env::temp_dir().join(format!("crawler-tamper-{}.pem", std::process::id()));
    std::fs::write(&ca, authority.pem()).expect("a file");
    is_online(port, &ca.to_string_lossy(), "watched");
    std::fs::remove_file(ca).expect("our own file");
    between.begin();
    let told = robot.wait_line("connection tampered with", JOINS);
    assert!(told.is_some(), "a changed record ends the session");
    // It goes on in the handshakes that follow: they come to nothing either.
    let told = robot.wait_line("broker not trusted", JOINS);
    assert!(told.is_some(), "nor is there another");
}
