//! The same robots and the same server with a broker that is not ours.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::time::Duration;

use crawler_tests::{Mosquitto, ReservedPort, Subscription, Terracrawler, wait_for, wait_for_with};
use serde_json::{Value, json};

const ROBOTS: usize = 10;
/// For everything that has to happen on a busy machine; pauses between two tries go up to 30 s.
const LIMIT: Duration = Duration::from_mins(3);
/// Tries of each client to reach its broker that are an outage and no hiccup.
const TRIES: usize = 4;

/// Hangs up on whoever connects, `count` times.
fn hang_up(port: u16, count: usize) {
    let listener = TcpListener::bind(("127.0.0.1", port)).expect("the broker is away");
    listener.set_nonblocking(true).expect("an option");
    let mut met = 0;
    wait_for_with("clients try again and again", LIMIT, &mut met, |met| {
        while listener.accept().is_ok() {
            *met += 1;
        }
        (*met >= count).then_some(())
    });
}

#[test]
fn a_broker_that_goes_away_for_long_is_survived() {
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let broker = Mosquitto::start(port);
    let url = format!("mqtt://127.0.0.1:{port}");
    let server = Terracrawler::start(&["up", "--robots", "10", "--broker", &url]);
    server.wait_online(ROBOTS, LIMIT);

    broker.kill();
    // The server says so instead of pretending, and keeps answering.
    wait_for("the server is not ready", LIMIT, || {
        (server.get("/readyz").0 == 503).then_some(())
    });
    assert_eq!(server.get("/healthz").0, 200);
    wait_for("nobody counts as online", LIMIT, || {
        server.online().is_empty().then_some(())
    });
    hang_up(port, TRIES * (ROBOTS + 1));
    assert_eq!(server.get("/readyz").0, 503);
    assert_eq!(server.get("/healthz").0, 200);

    let broker = Mosquitto::start(port);
    server.wait_online(ROBOTS, LIMIT);
    wait_for("the server is ready", LIMIT, || {
        (server.get("/readyz").0 == 200).then_some(())
    });
    let (status, body) = server.post("/api/v1/swarm/commands", &json!({"command": "stop"}));
    assert_eq!(status, 202, "{body}");
    let path = format!("/api/v1/commands/{}", body["id"].as_str().expect("an id"));
    let mut last = Value::Null;
    wait_for_with("every robot answers", LIMIT, &mut last, |last| {
        *last = server.get(&path).1;
        (last["counts"]["completed"] == ROBOTS).then_some(())
    });
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
    broker.kill();
}

/// Robots that the broker let in, by its log.
fn let_in(log: &str) -> BTreeSet<&str> {
    log.lines()
        .filter_map(|line| {
            let (_, name) = line
                .split_once("New client connected from ")?
                .1
                .split_once(" as ")?;
            let name = name.split(' ').next()?;
            name.starts_with("sim-").then_some(name)
        })
        .collect()
}

#[test]
fn robots_log_in_with_a_password_and_tell_when_it_was_refused() {
    const OBSERVER: (&str, &str) = ("observer", "of the test");
    const ROBOTS: usize = 3;
    let reserved = ReservedPort::new();
    let port = reserved.number();
    let right = [("rover", "open-sesame"), OBSERVER];
    let wrong = [("rover", "something-else"), OBSERVER];
    let broker = Mosquitto::start_guarded(port, &right);
    let url = format!("mqtt://rover:open-sesame@127.0.0.1:{port}");
    let server = Terracrawler::start(&["up", "--robots", "3", "--broker", &url]);
    server.wait_online(ROBOTS, LIMIT);
    let login = ["-u", OBSERVER.0, "-P", OBSERVER.1];
    let mut logs = Subscription::start_with(port, &login, "swarm/logs/+");
    assert_eq!(let_in(&broker.log()).len(), ROBOTS, "{}", broker.log());

    // The password is changed under them.
    let before = broker.log().len();
    broker.change_users(&wrong);
    wait_for("nobody counts as online", LIMIT, || {
        server.online().is_empty().then_some(())
    });
    wait_for("they try again and again", LIMIT, || {
        let refused = broker.log().matches("not authorised").count();
        (refused >= TRIES * (ROBOTS + 1)).then_some(())
    });
    let log = broker.log();
    assert_eq!(let_in(&log[before..]).len(), 0, "somebody got in: {log}");

    // And back again: what kept them away is told.
    broker.change_users(&right);
    let mut told = BTreeSet::new();
    logs.wait("every robot tells what kept it away", |topic, payload| {
        let record: Value = serde_json::from_str(payload).expect("a record in JSON");
        if record["event"] == "broker-credentials" {
            told.insert(topic.to_owned());
        }
        (told.len() == ROBOTS).then_some(())
    });
    server.wait_online(ROBOTS, LIMIT);
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
    assert!(!log.contains("sesame"), "{log}");
    broker.kill();
}
