//! The numbers of the server, in the text format that Prometheus reads. `docs/monitor.md` says what each of
//! them tells and when to worry.
//!
//! There are two kinds. What happens is counted as it happens, by whoever does it, in [`Metrics`], which the
//! parts of the server share. What merely *is*, such as the length of a queue, is read at every scrape: whoever
//! has it writes it into the [`Exposition`], called by [`Metrics::read`] or, where only the API knows it, by the
//! handler of the scrape. So nothing here knows the parts that are measured, and a label has no value that
//! somebody outside has made up.

mod audit;
mod dropped;
mod exposition;
mod fences;
mod http;
pub mod machine;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use crawler_protocol::open::Unknown;
use crawler_protocol::{ResponseStatus, Topic};
use prometheus_client::encoding::{EncodeLabelSet, text};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};

pub use audit::AuditLog;
pub use dropped::Dropped;
pub use exposition::Exposition;

/// What a command comes to that nobody answers.
const TIMEOUT: &str = "timeout";

/// A label with one of a few values known beforehand.
#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Kind {
    kind: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct CommandLabel {
    command: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct StatusLabel {
    status: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct ReasonLabel {
    reason: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct HttpLabel {
    class: &'static str,
}

/// Every number of the server.
pub struct Metrics {
    registry: Mutex<Registry>,
    messages_in: Family<Kind, Counter>,
    messages_in_total: AtomicU64,
    messages_out: Family<Kind, Counter>,
    messages_rejected: Family<Kind, Counter>,
    unknown_fields: Family<Kind, Counter>,
    unknown_words: Family<Kind, Counter>,
    commands_sent: Family<CommandLabel, Counter>,
    answers: Family<StatusLabel, Counter>,
    latency: Family<CommandLabel, Histogram>,
    http_requests: Family<HttpLabel, Counter>,
    live_clients: Gauge,
    live_dropped: Counter,
    broker_up: Gauge,
    broker_losses: Counter,
    journal_up: Gauge,
    journal_failures: Counter,
    /// How writing to the audit log goes.
    pub audit: AuditLog,
    http_latency: http::Latency,
    drops: Family<ReasonLabel, Counter>,
    fence_crossings: fences::Crossings,
    readers: Mutex<Vec<Box<Reader>>>,
}

/// Writes what it reads.
type Reader = dyn Fn(&mut Exposition) + Send + Sync;

/// From a quarter of a millisecond to a minute: an instantaneous command takes one, `goto` the other.
fn latency_histogram() -> Histogram {
    Histogram::new([
        0.000_25, 0.000_5, 0.001, 0.002, 0.003, 0.005, 0.007_5, 0.01, 0.015, 0.02, 0.03, 0.05,
        0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0,
    ])
}

impl Default for Metrics {
    fn default() -> Self {
        Self::new()
    }
}

impl Metrics {
    /// All at nothing.
    pub fn new() -> Self {
        let mut registry = Registry::with_prefix("terracrawler");
        let metrics = Self {
            messages_in: Family::default(),
            messages_in_total: AtomicU64::new(0),
            messages_out: Family::default(),
            messages_rejected: Family::default(),
            unknown_fields: Family::default(),
            unknown_words: Family::default(),
            commands_sent: Family::default(),
            answers: Family::default(),
            latency: Family::new_with_constructor(latency_histogram),
            http_requests: Family::default(),
            live_clients: Gauge::default(),
            live_dropped: Counter::default(),
            broker_up: Gauge::default(),
            broker_losses: Counter::default(),
            journal_up: Gauge::default(),
            journal_failures: Counter::default(),
            audit: AuditLog::new(&mut registry),
            http_latency: http::Latency::new(&mut registry),
            drops: Family::default(),
            fence_crossings: fences::Crossings::new(&mut registry),
            readers: Mutex::default(),
            registry: Mutex::default(),
        };
        let r = &mut registry;
        r.register(
            "mqtt_messages_in",
            "Messages received from robots, by topic",
            metrics.messages_in.clone(),
        );
        r.register(
            "mqtt_messages_out",
            "Messages published by the server, by topic",
            metrics.messages_out.clone(),
        );
        r.register(
            "mqtt_messages_rejected",
            "Messages that were not what they should be, by cause",
            metrics.messages_rejected.clone(),
        );
        r.register(
            "mqtt_unknown_fields",
            "Fields of robots' messages that this server does not know and passed over, by topic",
            metrics.unknown_fields.clone(),
        );
        r.register(
            "mqtt_unknown_words",
            "Words of robots' messages, such as states, that this server does not know, by topic",
            metrics.unknown_words.clone(),
        );
        r.register(
            "commands_sent",
            "Commands sent, counted once per robot they were for",
            metrics.commands_sent.clone(),
        );
        r.register(
            "command_answers",
            "Last answers to commands, by what they came to; timeout when none came",
            metrics.answers.clone(),
        );
        r.register_with_unit(
            "command_latency",
            "From sending a command to the robot's completed",
            Unit::Seconds,
            metrics.latency.clone(),
        );
        r.register(
            "http_requests",
            "HTTP requests answered, by class of status",
            metrics.http_requests.clone(),
        );
        r.register(
            "live_clients",
            "Readers of the live feed",
            metrics.live_clients.clone(),
        );
        r.register(
            "live_dropped",
            "Readers of the live feed that were too slow and were dropped",
            metrics.live_dropped.clone(),
        );
        r.register(
            "broker_connected",
            "1 while the server is connected to the broker",
            metrics.broker_up.clone(),
        );
        r.register(
            "broker_losses",
            "Connections to the broker that were lost",
            metrics.broker_losses.clone(),
        );
        r.register(
            "command_journal_up",
            "1 while commands can be written down",
            metrics.journal_up.clone(),
        );
        r.register(
            "command_journal_failures",
            "Writes of commands that failed",
            metrics.journal_failures.clone(),
        );
        r.register(
            "drops",
            "What the server let go because somebody was too slow, too fast or too late, by reason",
            metrics.drops.clone(),
        );
        // A counter that is not there before its first event has no rate at that event.
        for reason in Dropped::ALL.map(Dropped::name) {
            metrics
                .drops
                .get_or_create(&ReasonLabel { reason })
                .inc_by(0);
        }
        for status in [ResponseStatus::Completed.name(), TIMEOUT] {
            metrics
                .answers
                .get_or_create(&StatusLabel { status })
                .inc_by(0);
        }
        *metrics
            .registry
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = registry;
        metrics
    }

    /// Counts a message that was accepted.
    pub fn message_in(&self, topic: &Topic) {
        self.messages_in_total.fetch_add(1, Ordering::Relaxed);
        count(&self.messages_in, topic_kind(topic));
    }

    /// Counts what an accepted message had that is not known here: of a robot that is newer.
    pub fn unknown(&self, topic: &Topic, unknown: Unknown) {
        let kind = Kind {
            kind: topic_kind(topic),
        };
        let counts = [
            (&self.unknown_fields, unknown.fields),
            (&self.unknown_words, unknown.words),
        ];
        for (family, count) in counts {
            if count > 0 {
                family.get_or_create(&kind).inc_by(count.into());
            }
        }
    }

    /// Counts a message of the server.
    pub fn message_out(&self, topic: &Topic) {
        count(&self.messages_out, topic_kind(topic));
    }

    /// Counts a message that was not accepted, whatever topic it came on.
    pub fn message_rejected(&self, cause: &'static str) {
        self.messages_in_total.fetch_add(1, Ordering::Relaxed);
        count(&self.messages_rejected, cause);
    }

    /// Messages received so far, good and bad.
    pub fn messages_in_total(&self) -> u64 {
        self.messages_in_total.load(Ordering::Relaxed)
    }

    /// Counts a command that went to so many robots.
    pub fn command_sent(&self, command: &'static str, robots: usize) {
        self.commands_sent
            .get_or_create(&CommandLabel { command })
            .inc_by(robots as u64);
    }

    /// Counts what a command came to at a robot.
    pub fn answer(&self, status: &'static str) {
        self.answers.get_or_create(&StatusLabel { status }).inc();
    }

    /// Notes how long a robot took to complete a command.
    pub fn completed(&self, command: &'static str, took: Duration) {
        self.latency
            .get_or_create(&CommandLabel { command })
            .observe(took.as_secs_f64());
    }

    /// Counts a request that was answered with this status.
    pub fn http_request(&self, status: u16) {
        let class = match status {
            100..200 => "1xx",
            200..300 => "2xx",
            300..400 => "3xx",
            400..500 => "4xx",
            _ => "5xx",
        };
        self.http_requests.get_or_create(&HttpLabel { class }).inc();
    }

    /// Readers of the live feed have come, or gone.
    pub fn live_clients(&self, change: i64) {
        self.live_clients.inc_by(change);
    }

    /// Counts a reader of the live feed that was too slow.
    pub fn live_dropped(&self) {
        self.live_dropped.inc();
        self.dropped(Dropped::SlowReader);
    }

    /// Counts something that is let go.
    pub fn dropped(&self, reason: Dropped) {
        let reason = reason.name();
        self.drops.get_or_create(&ReasonLabel { reason }).inc();
    }

    /// Says whether the broker is connected.
    pub fn broker_connected(&self, up: bool) {
        self.broker_up.set(i64::from(up));
    }

    /// Counts a connection to the broker that was lost.
    pub fn broker_lost(&self) {
        self.broker_losses.inc();
    }

    /// Says whether commands can be written down.
    pub fn journal_up(&self, up: bool) {
        self.journal_up.set(i64::from(up));
    }

    /// Counts a write of commands that failed.
    pub fn journal_failed(&self) {
        self.journal_failures.inc();
    }

    /// Has something read at every scrape, in the order of these calls. What holds these metrics must not be
    /// kept by `write`: neither would ever end.
    pub fn read(&self, write: impl Fn(&mut Exposition) + Send + Sync + 'static) {
        let mut readers = self.readers.lock().unwrap_or_else(PoisonError::into_inner);
        readers.push(Box::new(write));
    }

    /// Everything as text, behind which goes what only the caller can read.
    pub fn exposition(&self) -> Exposition {
        let mut counted = String::new();
        let registry = self.registry.lock().unwrap_or_else(PoisonError::into_inner);
        // Writing to a String does not fail.
        let _ = text::encode(&mut counted, &registry);
        drop(registry);
        let mut out = Exposition::behind(counted);
        let readers = self.readers.lock().unwrap_or_else(PoisonError::into_inner);
        for write in readers.iter() {
            write(&mut out);
        }
        drop(readers);
        out
    }
}

fn count(family: &Family<Kind, Counter>, kind: &'static str) {
    family.get_or_create(&Kind { kind }).inc();
}

const fn topic_kind(topic: &Topic) -> &'static str {
    match topic {
        Topic::CommandSwarm | Topic::CommandRobot(_) | Topic::CommandExperiment => "command",
        Topic::Response(_) => "response",
        Topic::ResponseSwarm => "response_swarm",
        Topic::Status(_) => "status",
        Topic::Heartbeat(_) => "heartbeat",
        Topic::Telemetry(_) => "telemetry",
        Topic::Vision(_) => "vision",
        Topic::Image(_) => "image",
        Topic::Logs(_) => "logs",
        Topic::Map(_) => "map",
        Topic::Parameters(_) => "parameters",
        Topic::Cell { .. } => "cell",
        Topic::Pose(_) => "pose",
        Topic::Time => "time",
        Topic::Ota(_) => "ota",
        Topic::SimulatorCommand | Topic::SimulatorExperiment => "simulator",
    }
}
