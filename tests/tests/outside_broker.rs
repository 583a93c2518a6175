//! The same robots and the same server with a broker that is not ours.

use std::time::Duration;

use crawler_tests::{Mosquitto, Terracrawler, free_port, wait_for};
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
