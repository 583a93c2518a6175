//! The configurations that `terracrawler mosquitto` prints, taken at their word by Mosquitto.

use std::process::Command;
use std::time::Duration;

use crawler_tests::engines::mosquitto::Folder;
use crawler_tests::{Simulated, Terracrawler, wait_for, wait_for_with};
use serde_json::json;

const LIMIT: Duration = Duration::from_mins(2);

/// What `terracrawler mosquitto` prints.
fn printed(arguments: &[&str]) -> String {
    let output = Command::new(crawler_tests::terracrawler())
        .arg("mosquitto")
        .args(arguments)
        .output()
        .expect("terracrawler starts");
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).expect("text")
}

fn status(robot: &str) -> String {
    format!(
        r#"{{"robot":"{robot}","online":true,"kind":"physical","firmware":"0.1.0","board":"test","capabilities":[],"boot":{{"count":1,"cause":"power-on"}},"protocol":1}}"#
    )
}

#[test]
fn with_passwords_rules_and_tls_a_robot_speaks_for_itself_alone() {
    let broker = Folder::new()
        .users(&[
            ("server", "of-this-fleet"),
            ("rover-1", "one"),
            ("rover-2", "two"),
        ])
        .rules(&printed(&["acl"]))
        .with("log_type all")
        .tls()
        .start();
    let url = format!("mqtts://server:of-this-fleet@127.0.0.1:{}", broker.port());
    let certificate = broker.certificate();
    let authority = certificate.to_str().expect("a path");
    let server = Terracrawler::start(&["serve", "--broker", &url, "--broker-ca", authority]);

    let known = |robot: &str| server.get(&format!("/api/v1/robots/{robot}")).0 == 200;
    // Another's status, and then its own: who sees the second would have seen the first.
    let first = ("rover-1", "one");
    broker.publish(first, "swarm/status/rover-2", &status("rover-2"));
    let own = broker.publish(first, "swarm/status/rover-1", &status("rover-1"));
    assert!(own.status.success(), "{own:?}");
    wait_for("the robot is known", LIMIT, || {
        known("rover-1").then_some(())
    });
    assert!(!known("rover-2"), "{}", broker.log());
    let stranger = broker.publish(("rover-1", "two"), "swarm/status/rover-1", "");
    assert!(!stranger.status.success(), "{stranger:?}");
    // Nor does it command.
    let command = r#"{"command":"stop","timestamp":1,"seq":1,"source":"rover-1"}"#;
    broker.publish(first, "swarm/command/swarm", command);
    let mut log = String::new();
    wait_for_with("the broker denies it", LIMIT, &mut log, |log| {
        *log = broker.log();
        log.contains("Denied PUBLISH from rover-1").then_some(())
    });
}

#[test]
fn who_sees_everything_sees_no_updates() {
    let (server, viewer) = (("server", "of-this-fleet"), ("eve", "looks on"));
    let robot = ("rover-1", "one");
    let broker = Folder::new()
        .users(&[server, viewer, robot])
        .rules(&printed(&["acl", "--viewer", "eve"]))
        .with("log_type all")
        .start();
    let eve = broker.listen(viewer, "swarm/#");
    let own = broker.listen(server, "swarm/ota/+");
    for topic in ["swarm/ota/rover-1", "swarm/heartbeat/rover-1"] {
        let sent = broker.publish(robot, topic, "{}");
        assert!(sent.status.success(), "{sent:?}");
    }
    for (listener, first) in [(eve, "swarm/heartbeat/rover-1"), (own, "swarm/ota/rover-1")] {
        assert_eq!(listener.heard(), format!("{first} {{}}"));
    }
    // What a robot is told about its update no other robot reads.
    let own = broker.listen(robot, "swarm/ota/#");
    for topic in ["swarm/ota/rover-2", "swarm/ota/rover-1"] {
        broker.publish(server, topic, "{}");
    }
    assert_eq!(own.heard(), "swarm/ota/rover-1 {}");
}

#[test]
fn a_bridge_carries_robots_of_a_site_up_and_commands_down() {
    let middle = Folder::new()
        .users(&[("server", "of-this-fleet"), ("north", "a-site")])
        .rules(&printed(&["acl", "--bridge", "north"]))
        .tls()
        .start();
    let url = format!("mqtts://north:a-site@127.0.0.1:{}", middle.port());
    let certificate = middle.certificate();
    let authority = certificate.to_str().expect("a path");
    let bridge = [
        "bridge",
        "north",
        "--broker",
        &url,
        "--broker-ca",
        authority,
    ];
    let site = Folder::new().anybody().with(&printed(&bridge)).start();
    let _robots = Simulated::start(site.port(), &["--robots", "3"]);

    let url = format!("mqtts://server:of-this-fleet@127.0.0.1:{}", middle.port());
    let server = Terracrawler::start(&["serve", "--broker", &url, "--broker-ca", authority]);
    server.wait_online(3, LIMIT);
    let (status, body) = server.post("/api/v1/swarm/commands", &json!({"command": "identify"}));
    assert_eq!(status, 202, "{body}");
    let path = format!("/api/v1/commands/{}", body["id"].as_str().expect("an id"));
    wait_for("every robot answers", LIMIT, || {
        let (_, command) = server.get(&path);
        (command["counts"]["completed"] == 3).then_some(())
    });
    wait_for("telemetry comes through", LIMIT, || {
        let (_, robot) = server.get("/api/v1/robots/sim-0001");
        (!robot["pose"].is_null()).then_some(())
    });
}
