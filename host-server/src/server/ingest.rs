//! From the bus to fleet, commands and events.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crawler_protocol::Topic;
use serde_json::json;

use crate::accounts::{self, Entry};
use crate::bus::{Incoming, Receiver};
use crate::commands::{CommandView, OutcomeStatus};
use crate::fleet::{Level, Received};
use crate::http::{self, App};

/// Takes what the bus receives.
pub(super) struct Ingest {
    app: Arc<App>,
}

impl Ingest {
    pub(super) fn new(app: Arc<App>) -> Arc<Self> {
        Arc::new(Self { app })
    }
}

impl Ingest {
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
        let (received, known) = {
            let mut fleet = self.app.fleet.lock();
            let received = fleet.receive(message, now);
            // A retained one is of long ago.
            if let Ok((Topic::Telemetry(robot), _)) = &received
                && !message.retained
                && let Some(telemetry) = fleet.get(robot).and_then(|robot| robot.telemetry.as_ref())
            {
                let sample = http::sample(telemetry, accounts::now_ms());
                // What it cannot take, it counts.
                let _ = self.app.records.history().push(sample);
            }
            let known = match &received {
                Ok((_, Received::Response(response))) => fleet.get(&response.robot).is_some(),
                _ => false,
            };
            (received, known)
        };
        match received {
            Ok((topic, received)) => {
                self.app.metrics.message_in(&topic);
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

/// Tells of a command that is over, where it is worth a line: those to the swarm, and those that
/// came to nothing.
pub(super) fn tell(app: &App, command: &CommandView) {
    app.trail.note(Entry {
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
