//! Halts, one after the other, and the telemetry of some robots, at an MQTT client of an operator.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crawler_tests::measure::{milliseconds, percentile, unix_ms};
use rumqttc::Outgoing;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::Packet;
use rumqttc::v5::{Client, Event, MqttOptions};
use serde::Deserialize;
use serde_json::json;

/// Pause between two halts.
const PAUSE: Duration = Duration::from_millis(50);
/// For an answer.
const ANSWER: Duration = Duration::from_secs(10);
/// Robots whose telemetry is listened to, at most.
const LISTENED: usize = 50;

/// Halts under way.
pub(crate) struct Halts {
    shared: Arc<Shared>,
    client: Client,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    open: Mutex<HashMap<u64, Open>>,
    /// When each robot was last heard to have restarted, and how often it has started.
    restarts: Mutex<HashMap<String, (Instant, u64)>>,
    measured: Mutex<Measured>,
    telemetry: Mutex<BTreeMap<String, u64>>,
    stop: AtomicBool,
    seq: AtomicU64,
}

/// A halt that is not answered yet.
#[derive(Debug)]
struct Open {
    sent: Instant,
    robot: String,
}

/// What has been measured since it was last taken.
#[derive(Debug, Default)]
pub(crate) struct Measured {
    /// From the publish of a halt to its `completed`.
    took: Vec<Duration>,
    /// Halts that were not answered, and of those the ones of robots that have restarted meanwhile: a robot begins a
    /// session anew then, which what waits in the one before does not outlive, and stands.
    pub(crate) unanswered: usize,
    pub(crate) restarting: usize,
    /// Telemetry that came, of the robots listened to, and what is missing between.
    pub(crate) telemetry: u64,
    pub(crate) lost: u64,
}

#[derive(Deserialize)]
struct Answer {
    seq: u64,
    status: String,
}

#[derive(Deserialize)]
struct Status {
    robot: String,
    boot: Boot,
}

#[derive(Deserialize)]
struct Boot {
    count: u64,
}

#[derive(Deserialize)]
struct Sample {
    robot: String,
    seq: u64,
}

impl Halts {
    pub(crate) fn start(port: u16, robots: usize) -> Self {
        let mut options = MqttOptions::new("bench", "127.0.0.1", port);
        options.set_keep_alive(Duration::from_secs(30));
        // Nagle's algorithm waits up to 40 ms for the other side's delayed acknowledgement.
        let mut network = rumqttc::NetworkOptions::new();
        network.set_tcp_nodelay(true);
        options.set_network_options(network);
        let (client, mut connection) = Client::new(options, 4_096);
        let listened = listened(robots).map(|robot| format!("swarm/telemetry/sim-{robot:04}"));
        let of_all = ["swarm/response/robot/+", "swarm/status/+"].map(str::to_owned);
        for filter in listened.chain(of_all) {
            client.subscribe(filter, QoS::AtLeastOnce).expect("room");
        }
        let shared = Arc::new(Shared::default());
        shared.seq.store(unix_ms(), Ordering::Relaxed);
        let hearing = Arc::clone(&shared);
        let listener = std::thread::spawn(move || {
            for event in connection.iter() {
                match event.expect("the session holds") {
                    Event::Incoming(Packet::Publish(publish)) => {
                        let now = Instant::now();
                        if publish.topic.starts_with(b"swarm/telemetry/") {
                            hearing.sample(&publish.payload);
                        } else if publish.topic.starts_with(b"swarm/status/") {
                            hearing.status(&publish.payload, now);
                        } else {
                            hearing.answer(&publish.payload, now);
                        }
                    }
                    Event::Outgoing(Outgoing::Disconnect) => return,
                    _ => {}
                }
            }
        });
        let (giving, sender) = (Arc::clone(&shared), client.clone());
        let giver = std::thread::spawn(move || {
            for turn in 0.. {
                if giving.stop.load(Ordering::Relaxed) {
                    return;
                }
                giving.give(&sender, turn * 7 % robots + 1);
                std::thread::sleep(PAUSE);
            }
        });
        Self {
            shared,
            client,
            threads: vec![giver, listener],
        }
    }

    /// What was measured since this was called last. Halts that are still open are left to the next time.
    pub(crate) fn take(&self) -> Measured {
        let mut open = self.shared.open.lock().expect("open");
        let late: Vec<Open> = open
            .extract_if(|_, open| open.sent.elapsed() >= ANSWER)
            .map(|(_, open)| open)
            .collect();
        let restarts = self.shared.restarts.lock().expect("restarts");
        let restarting = late.iter().filter(|open| {
            let restart = restarts.get(&open.robot);
            restart.is_some_and(|(at, _)| *at >= open.sent)
        });
        let mut measured = std::mem::take(&mut *self.shared.measured.lock().expect("measured"));
        measured.unanswered += late.len();
        measured.restarting += restarting.count();
        measured.took.sort_unstable();
        measured
    }

    pub(crate) fn stop(self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let mut threads = self.threads.into_iter();
        let giver = threads.next().expect("who gives");
        giver.join().expect("who gives");
        self.client.disconnect().expect("the session holds");
        for listener in threads {
            listener.join().expect("who listens");
        }
    }
}

/// Which robots are listened to.
fn listened(robots: usize) -> impl Iterator<Item = usize> {
    (1..=robots).step_by(robots.div_ceil(LISTENED))
}

impl Shared {
    fn give(&self, client: &Client, robot: usize) {
        let seq = self.seq.fetch_add(1, Ordering::Relaxed);
        let command = json!({
            "command": "stop", "timestamp": unix_ms(), "seq": seq, "source": "bench"
        });
        let robot = format!("sim-{robot:04}");
        let topic = format!("swarm/command/robot/{robot}");
        let payload = command.to_string();
        let sent = Instant::now();
        let open = Open { sent, robot };
        self.open.lock().expect("open").insert(seq, open);
        let sent = client.publish(topic, QoS::AtLeastOnce, false, payload);
        sent.expect("the session holds");
    }

    fn answer(&self, payload: &[u8], now: Instant) {
        let Ok(answer) = serde_json::from_slice::<Answer>(payload) else {
            return;
        };
        if answer.status != "completed" {
            return;
        }
        let open = self.open.lock().expect("open").remove(&answer.seq);
        if let Some(open) = open {
            let mut measured = self.measured.lock().expect("measured");
            measured.took.push(now - open.sent);
        }
    }

    /// Notes a robot that has started once more.
    fn status(&self, payload: &[u8], now: Instant) {
        let Ok(Status { robot, boot }) = serde_json::from_slice(payload) else {
            return;
        };
        let mut restarts = self.restarts.lock().expect("restarts");
        let known = restarts.get(&robot).map(|(_, count)| *count);
        if known != Some(boot.count) {
            restarts.insert(robot, (now, boot.count));
        }
    }

    /// Counts what is missing since the last one. A robot that restarts counts from its beginning.
    fn sample(&self, payload: &[u8]) {
        let Ok(Sample { robot, seq }) = serde_json::from_slice(payload) else {
            return;
        };
        let before = self.telemetry.lock().expect("telemetry").insert(robot, seq);
        let missing = before.map_or(0, |before| seq.saturating_sub(before + 1));
        let mut measured = self.measured.lock().expect("measured");
        measured.telemetry += 1;
        measured.lost += missing;
    }
}

impl Measured {
    /// Halts that were answered.
    pub(crate) const fn answered(&self) -> usize {
        self.took.len()
    }

    /// A percentile of how long an answer took, in milliseconds.
    pub(crate) fn at(&self, percent: usize) -> f64 {
        percentile(&self.took, percent).map_or(f64::INFINITY, milliseconds)
    }
}
