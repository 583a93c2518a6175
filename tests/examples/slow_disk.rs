//! How long a halt takes while the disk of the server is slow, and others set parameters.
//!
//! `cargo xtask bench disk [--seconds N] [--robots N]` runs it and prints the tables that `docs/numbers.md`
//! records. Every `fsync` and `fdatasync` of the server is held up, by a library that is preloaded. It fails
//! when a halt was refused, or did not reach its robot.

use std::collections::HashMap;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crawler_protocol::{Action, Command, MAX_MESSAGE, Source};
use crawler_tests::measure::{metrics, milliseconds, percentile, sum, unix_ms};
use crawler_tests::{Simulated, Terracrawler, agent};
use rumqttc::Outgoing;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Event, MqttOptions};
use serde_json::{Value, json};

/// How long the disk takes longer.
const DELAYS: [Duration; 3] = [
    Duration::ZERO,
    Duration::from_millis(200),
    Duration::from_secs(2),
];
/// Who sets parameters, one after the other.
const OPERATORS: usize = 4;
/// Pause between two halts of a kind.
const HALT_EVERY: Duration = Duration::from_millis(200);
const HEALTH_EVERY: Duration = Duration::from_millis(50);
/// Robots send five samples a second each, so a server that waits for nobody takes some in every tenth of a
/// second.
const COUNT_EVERY: Duration = Duration::from_millis(100);
/// Of one operator, on a disk that is quick: nobody presses faster.
const SET_EVERY: Duration = Duration::from_millis(25);
/// Before anything is measured.
const WARM_UP: Duration = Duration::from_secs(5);
/// For what is under way at the end.
const PATIENCE: Duration = Duration::from_secs(10);
const ONLINE: Duration = Duration::from_mins(3);

/// What the server counts of it.
const TELEMETRY: &str = "terracrawler_mqtt_messages_in_total{kind=\"telemetry\"}";

/// How a halt is given, and which.
const HALTS: [(Way, &str); 4] = [
    (Way::Http, "stop"),
    (Way::Http, "estop"),
    (Way::Mqtt, "stop"),
    (Way::Mqtt, "estop"),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Http,
    Mqtt,
}

/// One halt.
struct Halt {
    kind: usize,
    robot: usize,
    begun: Instant,
    /// When HTTP answered 202, or the robot itself over MQTT.
    answered: Option<Instant>,
    /// Over MQTT: its number.
    seq: u64,
}

/// What was heard at the broker, by when it came first.
#[derive(Default)]
struct Heard {
    /// Commands, by robot and name.
    commands: HashMap<(usize, String), Vec<Instant>>,
    /// Last answers of robots, by robot and number.
    answers: HashMap<(usize, u64), Instant>,
}

/// What is measured with one disk.
#[derive(Default)]
struct Measured {
    halts: Mutex<Vec<Halt>>,
    heard: Mutex<Heard>,
    /// How long 202 took, and how many were refused.
    settings: Mutex<(Vec<Duration>, usize)>,
    health: Mutex<Vec<Duration>>,
    /// The longest stretch in which the server took in no telemetry.
    pause: Mutex<Duration>,
    stop: AtomicBool,
}

fn main() -> ExitCode {
    let (mut seconds, mut robots) = (60_u64, 500_usize);
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let number: Option<u32> = arguments.next().and_then(|text| text.parse().ok());
        let number = number.filter(|number| *number > 0);
        let number = number.unwrap_or_else(|| panic!("{name} takes a number above 0"));
        match name.as_str() {
            "--seconds" => seconds = number.into(),
            "--robots" => robots = number as usize,
            _ => panic!("{name}: --seconds N or --robots N"),
        }
    }
    rlimit::increase_nofile_limit(20 * robots as u64 + 500).expect("enough sockets");
    println!(
        "{robots} robots in a process of their own, {OPERATORS} operators who set parameters, {seconds} s with \
         each disk."
    );
    let runs: Vec<Run> = DELAYS
        .iter()
        .map(|&delay| run(delay, robots, Duration::from_secs(seconds)))
        .collect();
    println!(
        "\n| `fsync` takes longer by | halt | given | delivered: p50, ms | p99 | worst | answered: p50, ms | p99 \
         | worst |\n|---:|---|---:|---:|---:|---:|---:|---:|---:|"
    );
    for run in &runs {
        println!("{}", run.halts.join("\n"));
    }
    println!(
        "\n| `fsync` takes longer by | `set`: 202 | refused | p50, ms | p99 | `/healthz`: p50, ms | p99 | worst \
         | telemetry, 1/s | longest pause, ms | let go |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
    );
    for run in &runs {
        println!("{}", run.others);
    }
    let wrong: usize = runs.iter().map(|run| run.wrong).sum();
    if wrong == 0 {
        return ExitCode::SUCCESS;
    }
    println!("WRONG: {wrong} halts were refused, or did not reach their robot");
    ExitCode::FAILURE
}

/// The rows of one disk.
struct Run {
    halts: Vec<String>,
    others: String,
    wrong: usize,
}

fn run(delay: Duration, robots: usize, span: Duration) -> Run {
    // What is made once is made on a disk that is as it is.
    let mut server = Terracrawler::start(&["serve"]);
    server.end();
    server.slow_disk(delay);
    server.resume();
    let simulated = Simulated::start(server.mqtt(), &["--robots", &robots.to_string()]);
    server.wait_online(robots, ONLINE);
    let measured = Arc::new(Measured::default());
    let (client, listener) = listen(&measured, server.mqtt(), robots);
    std::thread::sleep(WARM_UP);
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    let mut work = |work: Box<dyn FnOnce(&Measured) + Send>| {
        let measured = Arc::clone(&measured);
        threads.push(std::thread::spawn(move || work(&measured)));
    };
    let before = (Instant::now(), metrics(&server));
    for (kind, (way, name)) in HALTS.into_iter().enumerate() {
        let (url, client) = (server.url(), client.clone());
        work(Box::new(move |measured| match way {
            Way::Http => over_http(measured, &url, kind, name, robots),
            Way::Mqtt => over_mqtt(measured, &client, kind, name, robots),
        }));
    }
    for operator in 0..OPERATORS {
        let url = server.url();
        work(Box::new(move |measured| {
            set(measured, &url, operator, robots);
        }));
    }
    let url = server.url();
    work(Box::new(move |measured| ask(measured, &url)));
    let url = server.url();
    work(Box::new(move |measured| count(measured, &url)));
    std::thread::sleep(span);
    let (took, after) = (before.0.elapsed(), metrics(&server));
    measured.stop.store(true, Ordering::Relaxed);
    for thread in threads {
        thread.join().expect("a thread");
    }
    wait_for_answers(&measured);
    client.disconnect().expect("the connection");
    listener.join().expect("the listener");
    drop(simulated);
    server.kill();
    let grown = |name: &str| sum(&after, name) - sum(&before.1, name);
    let telemetry = grown(TELEMETRY);
    let let_go = grown("terracrawler_drops_total") + grown("terracrawler_history_dropped_total");
    measured.rows(delay, telemetry / took.as_secs_f64(), let_go)
}

/// Whether this was acknowledged.
fn give(agent: &ureq::Agent, url: &str, robot: usize, body: &Value) -> bool {
    let answer = agent
        .post(format!("{url}/api/v1/robots/{}/commands", id(robot)))
        .send_json(body);
    answer.is_ok_and(|mut answer| {
        // To its end, so that the connection can be used again.
        let _ = answer.body_mut().read_to_string();
        answer.status() == 202
    })
}

fn id(robot: usize) -> String {
    format!("sim-{:04}", robot + 1)
}

/// Works at regular times, until it is over.
fn regularly(measured: &Measured, pause: Duration, mut work: impl FnMut(usize)) {
    let mut due = Instant::now();
    for turn in 0.. {
        if measured.stop.load(Ordering::Relaxed) {
            return;
        }
        work(turn);
        // What could not be done in time is not made up for.
        due = (due + pause).max(Instant::now());
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
}

/// Each kind of halt has robots of its own.
fn whose(kind: usize, turn: usize, robots: usize) -> usize {
    (turn * HALTS.len() + kind) % robots
}

fn over_http(measured: &Measured, url: &str, kind: usize, name: &str, robots: usize) {
    let agent = agent();
    regularly(measured, HALT_EVERY, |turn| {
        let robot = whose(kind, turn, robots);
        let begun = Instant::now();
        let good = give(&agent, url, robot, &json!({ "command": name }));
        measured.halts.lock().expect("halts").push(Halt {
            kind,
            robot,
            begun,
            answered: good.then(Instant::now),
            seq: 0,
        });
    });
}

fn over_mqtt(measured: &Measured, client: &Client, kind: usize, name: &str, robots: usize) {
    let source = Source::new("bench").expect("a source");
    let first = unix_ms();
    regularly(measured, HALT_EVERY, |turn| {
        let robot = whose(kind, turn, robots);
        let seq = first + turn as u64;
        let command = Command {
            action: match name {
                "stop" => Action::Stop,
                _ => Action::Estop,
            },
            timestamp: unix_ms(),
            seq,
            source: source.clone(),
        };
        let mut buffer = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buffer).expect("a message");
        let payload = buffer.get(..length).expect("its length").to_vec();
        let begun = Instant::now();
        let topic = format!("swarm/command/robot/{}", id(robot));
        let sent = client.publish(topic, QoS::AtLeastOnce, false, payload);
        sent.expect("the connection");
        measured.halts.lock().expect("halts").push(Halt {
            kind,
            robot,
            begun,
            answered: None,
            seq,
        });
    });
}

/// Sets a parameter of one robot after the other.
fn set(measured: &Measured, url: &str, operator: usize, robots: usize) {
    let agent = agent();
    regularly(measured, SET_EVERY, |turn| {
        let robot = (turn * OPERATORS + operator) % robots;
        let value = 300 + (turn % 100);
        let body = json!({ "command": "set", "parameters": { "safe_distance_mm": value } });
        let begun = Instant::now();
        let good = give(&agent, url, robot, &body);
        let mut settings = measured.settings.lock().expect("settings");
        if good {
            settings.0.push(begun.elapsed());
        } else {
            settings.1 += 1;
        }
    });
}

fn ask(measured: &Measured, url: &str) {
    let agent = agent();
    regularly(measured, HEALTH_EVERY, |_| {
        let begun = Instant::now();
        let mut answer = agent.get(format!("{url}/healthz")).call().expect("healthz");
        answer.body_mut().read_to_string().expect("healthz");
        assert_eq!(answer.status(), 200, "healthz");
        let took = begun.elapsed();
        measured.health.lock().expect("health").push(took);
    });
}

/// Looks for the longest stretch in which no telemetry is taken in.
fn count(measured: &Measured, url: &str) {
    let agent = agent();
    let (mut last, mut since) = (0.0, Instant::now());
    regularly(measured, COUNT_EVERY, |_| {
        let mut answer = agent.get(format!("{url}/metrics")).call().expect("metrics");
        let text = answer.body_mut().read_to_string().expect("metrics");
        assert_eq!(answer.status(), 200, "metrics");
        let taken = sum(&text, TELEMETRY);
        let now = Instant::now();
        let mut pause = measured.pause.lock().expect("pause");
        *pause = (*pause).max(now - since);
        if taken > last {
            (last, since) = (taken, now);
        }
    });
}

/// Notes when commands and answers come past, until this side ends the connection.
fn listen(measured: &Arc<Measured>, port: u16, robots: usize) -> (Client, JoinHandle<()>) {
    let options = MqttOptions::new("bench", "127.0.0.1", port);
    let (client, mut connection) = Client::new(options, 1_000);
    for filter in ["swarm/command/robot/+", "swarm/response/robot/+"] {
        client.subscribe(filter, QoS::AtMostOnce).expect("room");
    }
    let measured = Arc::clone(measured);
    let listener = std::thread::spawn(move || {
        for event in connection.iter() {
            let publish = match event.expect("the connection") {
                Event::Incoming(Packet::Publish(publish)) => publish,
                Event::Outgoing(Outgoing::Disconnect) => return,
                _ => continue,
            };
            let at = Instant::now();
            let topic = String::from_utf8_lossy(&publish.topic).into_owned();
            let Some(robot) = (0..robots).find(|robot| topic.ends_with(&id(*robot))) else {
                continue;
            };
            let Ok(message) = serde_json::from_slice::<Value>(&publish.payload) else {
                continue;
            };
            let mut heard = measured.heard.lock().expect("heard");
            if let Some(command) = message["command"].as_str() {
                let times = heard.commands.entry((robot, command.to_owned()));
                times.or_default().push(at);
            } else if message["status"] != "accepted" {
                let seq = message["seq"].as_u64().expect("a number");
                heard.answers.entry((robot, seq)).or_insert(at);
            }
        }
    });
    (client, listener)
}

/// Waits until every halt has been heard at the broker and answered, or nothing comes any more.
fn wait_for_answers(measured: &Measured) {
    let end = Instant::now() + PATIENCE;
    while Instant::now() < end && measured.missing() > 0 {
        std::thread::sleep(Duration::from_millis(50));
    }
}

impl Measured {
    /// Halts that were refused, not delivered or not answered.
    fn missing(&self) -> usize {
        let heard = self.heard.lock().expect("heard");
        let halts = self.halts.lock().expect("halts");
        let good = |halt: &&Halt| heard.delivered(halt).is_some() && heard.answered(halt).is_some();
        halts.len() - halts.iter().filter(good).count()
    }

    fn rows(&self, delay: Duration, telemetry: f64, let_go: f64) -> Run {
        let delay = if delay.is_zero() {
            "not held up".to_owned()
        } else {
            format!("{} ms", delay.as_millis())
        };
        let heard = self.heard.lock().expect("heard");
        let halts = self.halts.lock().expect("halts");
        let rows = HALTS.iter().enumerate().map(|(kind, (way, name))| {
            let own: Vec<&Halt> = halts.iter().filter(|halt| halt.kind == kind).collect();
            let times = |at: &dyn Fn(&Halt) -> Option<Instant>| {
                let took = own.iter().filter_map(|halt| Some(at(halt)? - halt.begun));
                times(took.collect())
            };
            format!(
                "| {delay} | `{name}`, {} | {} | {} | {} |",
                if *way == Way::Http { "HTTP" } else { "MQTT" },
                own.len(),
                times(&|halt| heard.delivered(halt)),
                times(&|halt| heard.answered(halt))
            )
        });
        let rows = rows.collect();
        let settings = self.settings.lock().expect("settings");
        let mut took = settings.0.clone();
        took.sort_unstable();
        let part = |percent| percentile(&took, percent).map_or(0.0, milliseconds);
        let pause = milliseconds(*self.pause.lock().expect("pause"));
        let others = format!(
            "| {delay} | {} | {} | {:.0} | {:.0} | {} | {telemetry:.0} | {pause:.0} | {let_go:.0} |",
            took.len(),
            settings.1,
            part(50),
            part(99),
            times(self.health.lock().expect("health").clone())
        );
        drop((heard, halts));
        Run {
            halts: rows,
            others,
            wrong: self.missing(),
        }
    }
}

impl Heard {
    fn delivered(&self, halt: &Halt) -> Option<Instant> {
        let name = HALTS.get(halt.kind)?.1.to_owned();
        let times = self.commands.get(&(halt.robot, name))?;
        times.iter().copied().find(|at| *at >= halt.begun)
    }

    fn answered(&self, halt: &Halt) -> Option<Instant> {
        halt.answered
            .or_else(|| self.answers.get(&(halt.robot, halt.seq)).copied())
    }
}

/// Median, 99th percentile and worst, in milliseconds.
fn times(mut took: Vec<Duration>) -> String {
    took.sort_unstable();
    let part = |percent| percentile(&took, percent).map_or(0.0, milliseconds);
    format!("{:.1} | {:.1} | {:.1}", part(50), part(99), part(100))
}
