//! Server, broker and live robots, measured from outside over real sockets.
//!
//! `cargo xtask bench fleet [--seconds N] [--batch N] [--apart] [ROBOTS...]` runs it and prints the table that
//! `docs/numbers.md` records. All is one process; with `--apart` robots have one of their own, and what is told of processor and
//! memory is the server's. Robots wander while it measures; with `--batch` they tell so many samples of telemetry at
//! once, in CBOR. Latency is taken at an operator's MQTT
//! client: from just before the publish of a `stop` to the arrival of its `completed`, through the
//! broker both ways. Stops are sent for ten seconds, or as long as asked.

use std::collections::HashMap;
use std::sync::mpsc;
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};

use crawler_tests::measure::{cpu_seconds, milliseconds, percentile, resident_mib, sum, unix_ms};
use crawler_tests::{Simulated, Terracrawler, measure, wait_for};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Connection, Event, MqttOptions};
use serde_json::{Value, json};

/// How long single commands go out, spread over the robots, where nothing else is asked for.
const COMMANDING: Duration = Duration::from_secs(10);
/// Pause between two of them.
const PAUSE: Duration = Duration::from_millis(20);
/// How long CPU and messages are averaged.
const STEADY: Duration = Duration::from_secs(20);
/// Pause between two looks at the real-time factor.
const LOOK: Duration = Duration::from_secs(5);
/// Answers that take longer count as missing.
const PATIENCE: Duration = Duration::from_secs(10);

/// How it is measured.
struct Settings {
    commanding: Duration,
    /// Samples of telemetry at once; `None` is each alone, in JSON.
    batch: Option<u8>,
    /// Robots have a process of their own.
    apart: bool,
}

fn main() {
    let mut sizes = Vec::new();
    let mut settings = Settings {
        commanding: COMMANDING,
        batch: None,
        apart: false,
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            // What `cargo bench` adds.
            "--bench" => {}
            "--seconds" => {
                let seconds = arguments.next().and_then(|text| text.parse().ok());
                let seconds = seconds.expect("--seconds takes a whole number");
                settings.commanding = Duration::from_secs(seconds);
            }
            "--batch" => {
                let samples = arguments.next().and_then(|text| text.parse().ok());
                settings.batch = Some(samples.expect("--batch takes a whole number"));
            }
            "--apart" => settings.apart = true,
            robots => sizes.push(
                robots
                    .parse()
                    .expect("a number of robots, --seconds N, --batch N or --apart"),
            ),
        }
    }
    if sizes.is_empty() {
        sizes = vec![50, 1000];
    }
    println!(
        "| robots | all online after | CPU, % of one core | memory, MiB | messages/s \
         | real-time factor: mean | worst | stop: answered | stop: p50, ms | p99, ms | worst, ms \
         | swarm stop: answered, ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for robots in sizes {
        println!("{}", run(robots, &settings));
    }
}

fn run(robots: usize, settings: &Settings) -> String {
    let began = Instant::now();
    let number = robots.to_string();
    let simulation = ["--robots", &number, "--seed", "1"];
    let (server, apart) = if settings.apart {
        let server = Terracrawler::start(&["serve"]);
        let robots = Simulated::start(server.mqtt(), &simulation);
        (server, Some(robots))
    } else {
        let arguments: Vec<&str> = ["up"].into_iter().chain(simulation).collect();
        (Terracrawler::start(&arguments), None)
    };
    wait_for("all robots online", Duration::from_mins(5), || {
        (metric(&server, "terracrawler_robots{status=\"online\"}") >= robots as f64).then_some(())
    });
    let online = began.elapsed();
    let mut operator = Operator::connect(server.mqtt());
    if let Some(samples) = settings.batch {
        operator.batches(samples, robots);
    }
    // Behaviours start and connection work settles.
    std::thread::sleep(Duration::from_secs(5));

    let before = (Instant::now(), cpu_seconds(server.id()), messages(&server));
    std::thread::sleep(STEADY);
    let span = before.0.elapsed().as_secs_f64();
    let cpu = (cpu_seconds(server.id()) - before.1) / span * 100.0;
    let rate = (messages(&server) - before.2) / span;

    let commands = (settings.commanding.as_millis() / PAUSE.as_millis()) as usize;
    let (mut latencies, factors) = std::thread::scope(|scope| {
        let (done, waits) = mpsc::channel::<()>();
        let server = &server;
        // A world of another process tells nobody.
        let watch =
            (!settings.apart).then(|| scope.spawn(move || real_time_factors(server, &waits)));
        let latencies = operator.single_stops(robots, commands);
        drop(done);
        let watched = |watch: ScopedJoinHandle<'_, _>| watch.join().expect("the watch ends");
        (latencies, watch.map_or_else(Vec::new, watched))
    });
    let factor = |of: Option<f64>| of.map_or_else(|| "–".to_owned(), |of| format!("{of:.3}"));
    let sum = factors.iter().copied().reduce(|sum, one| sum + one);
    let mean = factor(sum.map(|sum| sum / factors.len() as f64));
    let worst = factor(factors.iter().copied().reduce(f64::min));
    latencies.sort_unstable();
    let (answered, swarm) = operator.swarm_stop(robots);
    let memory = resident_mib(server.id());
    let share = format!("{} of {commands}", latencies.len());
    if let Some(robots) = apart {
        robots.interrupt();
    }
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
    format!(
        "| {robots} | {:.1} s | {cpu:.0} | {memory:.0} | {rate:.0} | {mean} | {worst} | {share} | {:.1} \
         | {:.1} | {:.1} | {answered} of {robots}, {:.0} |",
        online.as_secs_f64(),
        at_percent(&latencies, 50),
        at_percent(&latencies, 99),
        at_percent(&latencies, 100),
        milliseconds(swarm),
    )
}

/// The real-time factor now and every [`LOOK`], until nobody holds the other end of `done`.
fn real_time_factors(server: &Terracrawler, done: &mpsc::Receiver<()>) -> Vec<f64> {
    let mut factors = Vec::new();
    loop {
        factors.push(metric(server, "terracrawler_simulation_real_time_factor"));
        if done.recv_timeout(LOOK) != Err(mpsc::RecvTimeoutError::Timeout) {
            return factors;
        }
    }
}

/// An operator's own MQTT session.
struct Operator {
    client: Client,
    connection: Connection,
    seq: u64,
}

impl Operator {
    fn connect(port: u16) -> Self {
        let mut options = MqttOptions::new("bench", "127.0.0.1", port);
        options.set_keep_alive(Duration::from_secs(30));
        // Nagle's algorithm waits up to 40 ms for the other side's delayed acknowledgement.
        let mut network = rumqttc::NetworkOptions::new();
        network.set_tcp_nodelay(true);
        options.set_network_options(network);
        let (client, connection) = Client::new(options, 4096);
        let mut operator = Self {
            client,
            connection,
            seq: unix_ms(),
        };
        let client = &operator.client;
        client
            .subscribe("swarm/response/robot/+", QoS::AtLeastOnce)
            .expect("subscribe");
        // Waiting that is broken off begins to connect anew, which takes a while beside thousands of robots that have just come.
        while let Ok(event) = operator.connection.recv_timeout(Duration::from_mins(1)) {
            if let Event::Incoming(Packet::SubAck(_)) = event.expect("the session holds") {
                return operator;
            }
        }
        panic!("no SUBACK");
    }

    fn stop(&mut self, topic: &str) -> u64 {
        self.command(topic, json!({ "command": "stop" }))
    }

    fn command(&mut self, topic: &str, mut command: Value) -> u64 {
        self.seq += 1;
        command["timestamp"] = json!(unix_ms());
        command["seq"] = json!(self.seq);
        command["source"] = json!("bench");
        self.client
            .publish(topic, QoS::AtLeastOnce, false, command.to_string())
            .expect("publish");
        self.seq
    }

    /// Every robot tells so many samples of telemetry at once from now on, in CBOR.
    fn batches(&mut self, samples: u8, robots: usize) {
        let parameters = json!({ "telemetry_format": 1, "telemetry_batch": samples });
        let set = json!({ "command": "set", "parameters": parameters });
        let (answered, _) = self.swarm(set, robots);
        assert_eq!(answered, robots, "robots that tell batches");
    }

    /// Latency of every answered one of so many stops.
    fn single_stops(&mut self, robots: usize, commands: usize) -> Vec<Duration> {
        let mut open = HashMap::new();
        let mut latencies = Vec::new();
        for index in 0..commands {
            let robot = index * 7 % robots + 1;
            let sent = Instant::now();
            let seq = self.stop(&format!("swarm/command/robot/sim-{robot:04}"));
            open.insert(seq, sent);
            self.collect(sent + PAUSE, |seq, at| {
                if let Some(sent) = open.remove(&seq) {
                    latencies.push(at - sent);
                }
                false
            });
        }
        self.collect(Instant::now() + PATIENCE, |seq, at| {
            if let Some(sent) = open.remove(&seq) {
                latencies.push(at - sent);
            }
            open.is_empty()
        });
        latencies
    }

    /// How many robots completed one stop for the swarm, and when the last of them had.
    fn swarm_stop(&mut self, robots: usize) -> (usize, Duration) {
        self.swarm(json!({ "command": "stop" }), robots)
    }

    /// The same of any command.
    fn swarm(&mut self, command: Value, robots: usize) -> (usize, Duration) {
        let sent = Instant::now();
        let given = self.command("swarm/command/swarm", command);
        let (mut answered, mut last) = (0, sent);
        self.collect(sent + PATIENCE, |seq, at| {
            if seq == given {
                answered += 1;
                last = at;
            }
            answered == robots
        });
        (answered, last - sent)
    }

    /// Hands completed answers to `found` until it says enough or `deadline`.
    fn collect(&mut self, deadline: Instant, mut found: impl FnMut(u64, Instant) -> bool) {
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            let Ok(event) = self.connection.recv_timeout(left) else {
                return;
            };
            let Event::Incoming(Packet::Publish(publish)) = event.expect("the session holds")
            else {
                continue;
            };
            let at = Instant::now();
            let answer: Value = serde_json::from_slice(&publish.payload).expect("JSON");
            let seq = answer["seq"].as_u64().expect("a seq");
            if answer["status"] == "completed" && found(seq, at) {
                return;
            }
        }
    }
}

/// A percentile in milliseconds; infinite where nothing was answered.
fn at_percent(latencies: &[Duration], percent: usize) -> f64 {
    percentile(latencies, percent).map_or(f64::INFINITY, milliseconds)
}

/// The value of one line of `/metrics`.
fn metric(server: &Terracrawler, name: &str) -> f64 {
    let text = measure::metrics(server);
    text.lines()
        .find_map(|line| line.strip_prefix(name)?.trim().parse().ok())
        .unwrap_or_else(|| panic!("{name} is not in /metrics:\n{text}"))
}

/// Messages from robots so far, over all topics.
fn messages(server: &Terracrawler) -> f64 {
    sum(
        &measure::metrics(server),
        "terracrawler_mqtt_messages_in_total",
    )
}
