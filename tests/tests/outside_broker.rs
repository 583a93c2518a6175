//! The same robots and the same server with a broker that is not ours.

use std::time::Duration;

use crawler_tests::{Mosquitto, Terracrawler, free_port, subscribe_with, wait_for};
use serde_json::json;

const ROBOTS: usize = 10;

#[test]
fn a_broker_that_goes_away_for_a_minute_is_survived() {
    let port = free_port();
    let broker = Mosquitto::start(port);
    let url = format!("mqtt://127.0.0.1:{port}");
    let server = Terracrawler::start(&["up", "--robots", "10", "--broker", &url]);
    server.wait_online(ROBOTS, Duration::from_secs(30));

    broker.kill();
    // The server says so instead of pretending, and keeps answering.
    wait_for("the server is not ready", Duration::from_secs(20), || {
        (server.get("/readyz").0 == 503).then_some(())
    });
    assert_eq!(server.get("/healthz").0, 200);
    wait_for("nobody counts as online", Duration::from_secs(30), || {
        server.online().is_empty().then_some(())
    });
    std::thread::sleep(Duration::from_mins(1));

    let broker = Mosquitto::start(port);
    // Back-off goes up to 30 s.
    server.wait_online(ROBOTS, Duration::from_secs(50));
    wait_for("the server is ready", Duration::from_secs(40), || {
        (server.get("/readyz").0 == 200).then_some(())
    });
    let (status, body) = server.post("/api/v1/swarm/commands", &json!({"command": "stop"}));
    assert_eq!(status, 202, "{body}");
    let path = format!("/api/v1/commands/{}", body["id"].as_str().expect("an id"));
    wait_for("every robot answers", Duration::from_secs(10), || {
        let (_, command) = server.get(&path);
        (command["counts"]["completed"] == ROBOTS).then_some(())
    });
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
    broker.kill();
}

/// Events of log records, and how often each came, as the broker had them within `seconds`.
fn logged(port: u16, user: &str, password: &str, seconds: u32) -> Vec<String> {
    let login = ["-u", user, "-P", password];
    subscribe_with(port, &login, "swarm/logs/+", 1_000, seconds)
        .into_iter()
        .filter_map(|(_, payload)| {
            let record: serde_json::Value = serde_json::from_str(&payload).ok()?;
            Some(record["event"].as_str()?.to_owned())
        })
        .collect()
}

#[test]
fn robots_log_in_with_a_password_and_tell_when_it_was_refused() {
    let port = free_port();
    let broker = Mosquitto::start_guarded(port, "rover", "open-sesame");
    let url = format!("mqtt://rover:open-sesame@127.0.0.1:{port}");
    let server = Terracrawler::start(&["up", "--robots", "3", "--broker", &url]);
    server.wait_online(3, Duration::from_secs(30));

    // The password is changed under them.
    broker.kill();
    let broker = Mosquitto::start_guarded(port, "rover", "something-else");
    wait_for("nobody counts as online", Duration::from_secs(40), || {
        server.online().is_empty().then_some(())
    });
    std::thread::sleep(Duration::from_secs(20));
    let others = logged(port, "rover", "something-else", 3);
    assert_eq!(others, [""; 0], "nobody got in");

    // And back again: what kept them away is told.
    broker.kill();
    let broker = Mosquitto::start_guarded(port, "rover", "open-sesame");
    let events = logged(port, "rover", "open-sesame", 40);
    let refused = events.iter().filter(|event| *event == "broker-credentials");
    assert!(refused.count() >= 3, "{events:?}");
    server.wait_online(3, Duration::from_secs(50));
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
    assert!(!log.contains("sesame"), "{log}");
    broker.kill();
}
