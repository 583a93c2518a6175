//! The robot's own TLS, in simulated robots: with the server's listener (rustls) and with a broker
//! that nobody here wrote (Mosquitto, OpenSSL).

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crawler_protocol::Fleet;
use crawler_sim::run::live::{self, Authority, LiveConfig, LiveHandle};
use crawler_sim::scenario::Scenario;
use crawler_tests::{Mosquitto, Terracrawler, TestAuthority, free_port, subscribe_with};

const ROBOTS: u32 = 3;
/// To shake hands and to be heard, in seconds; the machine may be busy.
const JOINS_S: u32 = 60;

fn world(port: u16, authority: Authority) -> LiveHandle {
    let config = LiveConfig {
        fleet: Fleet::default(),
        broker_host: "127.0.0.1".to_owned(),
        broker_port: port,
        authority: Some(authority),
        credentials: None,
        scenario: Scenario::built_in("arena")
            .expect("it is there")
            .with_robots(ROBOTS),
        seed: 7,
        radio_proxy: None,
    };
    live::start(config).expect("a world")
}

/// Heartbeats that arrive within `seconds`, three of each robot at most.
fn heartbeats(port: u16, ca: &Path, seconds: u32) -> Vec<String> {
    let arguments = ["--cafile", &ca.to_string_lossy()];
    let count = 3 * ROBOTS as usize;
    subscribe_with(port, &arguments, "swarm/heartbeat/+", count, seconds)
        .into_iter()
        .map(|(topic, _)| topic)
        .collect()
}

fn all_are_heard(port: u16, ca: &Path) {
    let heard = heartbeats(port, ca, JOINS_S);
    for number in 1..=ROBOTS {
        let topic = format!("swarm/heartbeat/sim-{number:04}");
        assert!(heard.contains(&topic), "{topic}: {heard:?}");
    }
}

#[test]
fn robots_speak_tls_to_the_server() {
    let server = Terracrawler::start_encrypted(&["serve"]);
    let ca = server.authority();
    let der = Command::new("openssl")
        .args(["x509", "-outform", "DER", "-in"])
        .arg(&ca)
        .output()
        .expect("openssl is missing: cargo xtask setup");
    let pinned = Authority::of_certificate(&der.stdout).expect("a key of P-256");
    let world = world(server.mqtt(), pinned);
    all_are_heard(server.mqtt(), &ca);
    world.stop(Duration::from_secs(10)).expect("it ends");
}

#[test]
fn robots_speak_tls_to_mosquitto_and_to_no_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let (authority, other) = (TestAuthority::new(), TestAuthority::new());
    let ca = folder.path().join("ca.pem");
    std::fs::write(&ca, authority.pem()).expect("a file");
    let port = free_port();
    let (certificate, key) = authority.server(&["127.0.0.1", "localhost"], 2040);
    let _broker = Mosquitto::start_encrypted(port, &certificate, &key);
    let pin = |of: &TestAuthority| Authority::of_certificate(of.der()).expect("a key of P-256");

    let strangers = world(port, pin(&other));
    let heard = heartbeats(port, &ca, 6);
    assert!(heard.is_empty(), "nothing is said to a stranger: {heard:?}");
    strangers.stop(Duration::from_secs(10)).expect("it ends");

    let friends = world(port, pin(&authority));
    all_are_heard(port, &ca);
    friends.stop(Duration::from_secs(10)).expect("it ends");
}
