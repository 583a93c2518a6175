//! Examples that want a server, sent to one.

use std::process::Command;
use std::time::{Duration, Instant};

use crawler_tests::engines::program as installed;
use crawler_tests::{Terracrawler, wait_for};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Event, MqttOptions};
use serde_json::Value;
use tempfile::TempDir;

use super::commands::Request;
use super::page::{Example, Page};
use super::programs::{BESIDE, output, program, said};

/// For anything that has to happen on a busy machine.
const LIMIT: Duration = Duration::from_mins(2);

/// Status and body of the answer to a request.
fn send(server: &Terracrawler, request: &Request) -> (u16, String) {
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(Duration::from_mins(1)))
        .http_status_as_error(false)
        .build()
        .into();
    let mut made = ureq::http::Request::builder()
        .method(request.method.as_str())
        .uri(format!("{}{}", server.url(), request.target));
    if request.body.is_some() {
        made = made.header("content-type", "application/json");
    }
    let answer = match &request.body {
        Some(body) => agent.run(made.body(body.clone()).expect("a request")),
        None => agent.run(made.body(()).expect("a request")),
    };
    let mut answer = answer.unwrap_or_else(|error| panic!("{request:?}: {error}"));
    let body = answer.body_mut().read_to_vec().expect("a body");
    let text = String::from_utf8_lossy(&body).chars().take(2_000).collect();
    (answer.status().as_u16(), text)
}

/// Every call by `curl` is one that a server answers with what was asked for.
pub(crate) fn requests(pages: &[(Page, Vec<Example>)]) {
    // Its robot has a camera.
    let server = Terracrawler::start(&["up", "--robots", "1", "--scenario", "search"]);
    server.wait_online(1, LIMIT);
    let post = |target: &str, body: &str| Request {
        method: "POST".to_owned(),
        target: target.to_owned(),
        body: Some(body.to_owned()),
    };
    let mut count = 0;
    for (page, examples) in pages {
        let commands = examples.iter().flat_map(|example| {
            let commands = example.commands.iter();
            commands.map(move |command| (example.line, command))
        });
        for (line, command) in commands.filter(|(_, command)| command.calls("curl")) {
            let request = Request::of(&command.words[1..]);
            let request = request.unwrap_or_else(|why| panic!("{}: {why}", page.at(line)));
            let what = format!("{}: {} {}", page.at(line), request.method, request.target);
            // What the example before has asked for, such as an image, may be on its way, and so may the answer of a robot.
            wait_for(&what, LIMIT, || match send(&server, &request) {
                (200..300, _) => Some(()),
                (404 | 504, _) if request.method == "GET" => None,
                (status, text) => panic!("{what}: {status} {text}"),
            });
            // A world that a step left paused answers nobody.
            if request.target.ends_with("/simulator/commands") {
                let resume = post("/api/v1/simulator/commands", r#"{"command":"resume"}"#);
                assert_eq!(send(&server, &resume).0, 200, "the world goes on");
            }
            count += 1;
        }
    }
    assert!(count > 8, "only {count} calls");
    for path in BESIDE.into_iter().filter(|path| *path != "/mqtt") {
        let request = Request {
            method: "GET".to_owned(),
            target: path.to_owned(),
            body: None,
        };
        assert_eq!(send(&server, &request).0, 200, "{path}");
    }
}

/// The first example of the README for MQTT, as it stands there, by the program that it names and in
/// the shell that takes it apart: the robot accepts the command.
pub(crate) fn first_command(line: &str) {
    let server = Terracrawler::start(&["up", "--robots", "1", "--scenario", "empty"]);
    server.wait_online(1, LIMIT);
    let mut options = MqttOptions::new("listener", "127.0.0.1", server.mqtt());
    options.set_keep_alive(Duration::from_secs(30));
    let (client, mut connection) = Client::new(options, 16);
    let topic = "swarm/response/robot/sim-0001";
    client.subscribe(topic, QoS::AtLeastOnce).expect("asked");
    // The port is not the usual one here; all else is as it is typed.
    let port = server.mqtt();
    let client_program = installed("mosquitto_pub");
    let script = format!(
        "set -e\nmosquitto_pub() {{ {} -p {port} \"$@\"; }}\n{line}\n",
        client_program.display()
    );
    let publish = || {
        let output = Command::new("bash").args(["-c", &script]).output();
        let output = output.expect("bash");
        assert!(output.status.success(), "{}", said(&output));
    };
    let began = Instant::now();
    let mut heard = Vec::new();
    loop {
        assert!(began.elapsed() < LIMIT, "nothing was accepted: {heard:?}");
        match connection.recv_timeout(LIMIT) {
            Ok(Ok(Event::Incoming(Packet::SubAck(_)))) => publish(),
            Ok(Ok(Event::Incoming(Packet::Publish(message)))) => {
                let answer: Value = serde_json::from_slice(&message.payload).expect("JSON");
                if answer["status"] == "accepted" {
                    return;
                }
                // Until it has started and knows the time it refuses motion. Numbers are seconds here, so
                // that of the next try is another one when a second is over.
                let early = ["busy", "no_clock"]
                    .iter()
                    .any(|reason| answer["reason"] == *reason)
                    || answer["status"] == "stale";
                assert!(early, "{answer} after {heard:?}");
                heard.push(answer);
                std::thread::sleep(Duration::from_millis(1_100));
                publish();
            }
            Ok(Ok(_)) => {}
            other => panic!("{other:?} after {heard:?}"),
        }
    }
}

/// The line of the README that records a world, and the one that replays it: every robot does the
/// same once more.
pub(crate) fn recording(up: &[String], replay: &[String]) {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("run.mcap");
    let place = |word: &String| match word.as_str() {
        "run.mcap" => file.to_str().expect("UTF-8").to_owned(),
        word => word.to_owned(),
    };
    let words: Vec<String> = up.iter().map(place).collect();
    // The servers of tests are open anyway.
    let words = words
        .iter()
        .map(String::as_str)
        .filter(|word| *word != "--open");
    let server = Terracrawler::start(&words.collect::<Vec<_>>());
    // That of the scenario.
    server.wait_online(2, LIMIT);
    let (status, log) = server.interrupt();
    assert!(status.success(), "{status}: {log}");
    let words: Vec<String> = replay.iter().map(place).collect();
    let output = output(program(folder.path(), &words));
    let said = said(&output);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("2 of 2 robots do the same"), "{said}");
}
