//! From the bus to fleet, commands and events.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crawler_cluster::frame::{Message, Told};
use crawler_protocol::{Fleet, Telemetry, Topic};
use serde_json::json;

use crate::accounts::{self, Entry};
use crate::bus::{Incoming, Receiver};
use crate::cluster::is_shared;
use crate::commands::{CommandView, OutcomeStatus};
use crate::fleet::{Level, Received};
use crate::history::sample;
use crate::http::App;
use crate::metrics::Dropped;

/// What a sample may be older than the newest one of its message, in milliseconds. Robots send
/// nothing older than 2 s, unless their link is busy.
const OLDEST: u64 = 10_000;

/// Takes what the bus receives.
pub(super) struct Ingest {
    app: Arc<App>,
    fleet: Fleet,
}

impl Ingest {
    pub(super) fn new(app: Arc<App>, fleet: Fleet) -> Arc<Self> {
        Arc::new(Self { app, fleet })
    }

    /// Takes in what another server has heard and told. It has written it to the history, and
    /// counted it.
    pub(super) fn relayed(&self, message: &Message) {
        let text = std::str::from_utf8(&message.topic).unwrap_or_default();
        let topic = Topic::parse(&self.fleet, text);
        if !topic.as_ref().is_ok_and(is_shared) {
            return;
        }
        let now = Instant::now();
        let incoming = Incoming {
            topic: &message.topic,
            payload: &message.payload,
            retained: message.retained,
            content_type: message.content_type.as_deref(),
            properties: &message.properties,
        };
        let received = self.app.fleet.lock().receive(&incoming, now);
        if let Ok((topic, _)) = received {
            self.note(&topic, now);
        }
    }

    /// Tells the commands which robots are there: some wait for theirs.
    fn note(&self, topic: &Topic, now: Instant) {
        match topic {
            Topic::Status(robot) => {
                let told = {
                    let fleet = self.app.fleet.lock();
                    let status = fleet.get(robot).and_then(|known| known.status.as_ref());
                    status.map(|status| (status.online, status.boot.count))
                };
                if let Some((online, boot)) = told {
                    self.app.commands.status(robot, online, boot, now);
                }
            }
            Topic::Heartbeat(robot) => self.app.commands.heard(robot, now),
            _ => {}
        }
    }
}

impl Receiver for Ingest {
    fn message(&self, message: &Incoming<'_>) {
        let now = Instant::now();
        let (received, known, crossings) = {
            let mut fleet = self.app.fleet.lock();
            let received = fleet.receive(message, now);
            let crossings = fleet.take_crossings();
            // A retained one is of long ago.
            if let Ok((Topic::Telemetry(robot), Received::Telemetry(earlier))) = &received
                && !message.retained
                && let Some(newest) = fleet.get(robot).and_then(|robot| robot.telemetry.as_ref())
            {
                let now = accounts::now_ms();
                for telemetry in earlier.iter().chain([newest]) {
                    let sample = sample(telemetry, now - age(telemetry, newest));
                    if self.app.history.push(sample).is_err() {
                        self.app.metrics.dropped(Dropped::HistoryFull);
                    }
                }
            }
            let known = match &received {
                Ok((_, Received::Response(response))) => fleet.get(&response.robot).is_some(),
                _ => false,
            };
            (received, known, crossings)
        };
        // What another server has heard is its own to count, and to act upon.
        for crossing in &crossings {
            self.app.metrics.fence_crossing(crossing);
            self.app.fence_stops.note(crossing);
        }
        match received {
            Ok((topic, received)) => {
                self.app.metrics.message_in(&topic);
                if let Some(membership) = &self.app.membership
                    && is_shared(&topic)
                {
                    membership.queue.push(Told {
                        topic: message.topic,
                        payload: message.payload,
                        retained: message.retained,
                        content_type: message.content_type,
                        properties: message.properties,
                    });
                }
                // A robot subscribes before it tells its status, so the time will reach it.
                if matches!(topic, Topic::Status(_)) && !message.retained {
                    self.app.time_wanted.store(true, Ordering::Relaxed);
                }
                self.note(&topic, now);
                if let Received::Response(response) = received
                    && let Some(over) = self.app.commands.answer(&response, known, now)
                {
                    tell(&self.app, &over);
                }
            }
            Err(rejection) => self.app.metrics.message_rejected(rejection.name()),
        }
    }

    fn connection(&self, up: bool, text: &str) {
        self.app.commands.connection(up, Instant::now());
        let level = if up { Level::Info } else { Level::Error };
        let text = if up {
            text.to_owned()
        } else {
            format!("lost the broker: {text}")
        };
        self.app.fleet.lock().events.push(level, None, text);
    }
}

/// How many milliseconds a sample is older than the newest one of its message. The clock of a robot may
/// be wrong, or set in between; what passes on it is good for so short a time.
fn age(sample: &Telemetry, newest: &Telemetry) -> i64 {
    let age = newest.timestamp.saturating_sub(sample.timestamp);
    age.min(OLDEST) as i64
}

/// Tells of a command that is over, where it is worth a line: those to the swarm, and those that
/// came to nothing.
pub(super) fn tell(app: &App, command: &CommandView) {
    app.audit.note(Entry {
        who: command
            .source
            .strip_prefix("operator:")
            .unwrap_or(&command.source)
            .to_owned(),
        from: String::new(),
        action: "command.end",
        target: command.robot.clone().unwrap_or_else(|| "swarm".to_owned()),
        detail: json!({
            "id": command.id,
            "command": command.command,
            "reason": command.reason,
            "counts": command.counts,
        }),
        outcome: command.status.name().to_owned(),
    });
    let completed = command.status == OutcomeStatus::Completed;
    tracing::debug!(
        command = command.command,
        id = command.id,
        status = command.status.name(),
        "a command is over"
    );
    if completed && command.robot.is_some() {
        return;
    }
    let level = if completed { Level::Info } else { Level::Warn };
    let counts = command.counts;
    let text = match (&command.robot, command.reason) {
        (Some(_), Some(reason)) => {
            format!("{}: {} ({reason})", command.command, command.status.name())
        }
        (Some(_), None) => format!("{}: {}", command.command, command.status.name()),
        (None, _) => format!(
            "{} to the swarm: {} of {} completed",
            command.command,
            counts.completed,
            command.outcomes.len()
        ),
    };
    let robot = command
        .robot
        .as_deref()
        .and_then(|id| crawler_protocol::RobotId::new(id).ok());
    app.fleet.lock().events.push(level, robot, text);
}
