//! The robot's own TLS, in simulated robots: with the server's listener (rustls) and with a broker
//! that nobody here wrote (Mosquitto, OpenSSL).

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crawler_protocol::Fleet;
use crawler_sim::live::{self, Authority, LiveConfig, LiveHandle};
use crawler_sim::scenario::Scenario;
use crawler_tests::{Mosquitto, ReservedPort, Subscription, Terracrawler, TestAuthority, wait_for};

const ROBOTS: u32 = 3;
/// To shake hands, to be heard and to end; the machine may be busy.
const LIMIT: Duration = Duration::from_mins(2);

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
        release_keys: None,
        radio_proxy: None,
        other_ends: 1,
    };
    live::start(config).expect("a world")
}

fn heartbeats(port: u16, ca: &Path) -> Subscription {
    let arguments = ["--cafile", &ca.to_string_lossy()];
    Subscription::start_with(port, &arguments, "swarm/heartbeat/+")
}

fn all_are_heard(port: u16, ca: &Path) {
    let mut heard = BTreeSet::new();
    let all: BTreeSet<String> = (1..=ROBOTS)
        .map(|number| format!("swarm/heartbeat/sim-{number:04}"))
        .collect();
    heartbeats(port, ca).wait("a heartbeat of every robot", |topic, _| {
        heard.insert(topic.to_owned());
        (heard == all).then_some(())
    });
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
    world.stop(LIMIT).expect("it ends");
}

#[test]
fn robots_speak_tls_to_mosquitto_and_to_no_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let (authority, other) = (TestAuthority::new(), TestAuthority::new());
    let ca = folder.path().join("ca.pem");
    std::fs::write(&ca, authority.pem()).expect("a file");
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let (certificate, key) = authority.server(&["127.0.0.1", "localhost"], 2040);
    let broker = Mosquitto::start_encrypted(port, &certificate, &key);
    let pin = |of: &TestAuthority| Authority::of_certificate(of.der()).expect("a key of P-256");

    let let_in = || broker.log().matches(" as sim-").count();
    let heard = heartbeats(port, &ca);
    let before = broker.log().matches("New connection from").count();
    let strangers = world(port, pin(&other));
    wait_for("strangers try again and again", LIMIT, || {
        let tries = broker.log().matches("New connection from").count() - before;
        (tries >= 3 * ROBOTS as usize).then_some(())
    });
    assert_eq!(let_in(), 0, "{}", broker.log());
    strangers.stop(LIMIT).expect("it ends");
    assert_eq!(let_in(), 0, "{}", broker.log());
    let heard = heard.end();
    assert!(heard.is_empty(), "nothing is said to a stranger: {heard:?}");

    let friends = world(port, pin(&authority));
    all_are_heard(port, &ca);
    assert_eq!(let_in(), ROBOTS as usize, "{}", broker.log());
    friends.stop(LIMIT).expect("it ends");
}
