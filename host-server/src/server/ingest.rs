//! From the bus to fleet, commands and events.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crawler_protocol::Topic;

use crate::bus::{Incoming, Receiver};
use crate::commands::{CommandView, OutcomeStatus};
use crate::fleet::{Level, Received};
use crate::http::App;

/// Takes what the bus receives.
pub(super) struct Ingest {
    app: Arc<App>,
}

impl Ingest {
    pub(super) fn new(app: Arc<App>) -> Arc<Self> {
        Arc::new(Self { app })
    }
}

impl Receiver for Ingest {
    fn message(&self, message: &Incoming<'_>) {
        let now = Instant::now();
        let (received, known) = {
            let mut fleet = self.app.fleet.lock();
            let received = fleet.receive(message, now);
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
