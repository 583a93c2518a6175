//! Commands that are over, in the audit log and as events.

use std::sync::Arc;

use crawler_protocol::RobotId;
use serde_json::json;

use crawler_commands::{CommandView, OutcomeStatus};
use crawler_fleet::{Level, SharedFleet};
use crawler_records::audit_log::{Entry, Notes};

/// Tells of commands that are over. A clone is another handle of the same.
#[derive(Clone)]
pub(super) struct OutcomeLog {
    fleet: Arc<SharedFleet>,
    audit: Notes,
}

impl OutcomeLog {
    pub(super) const fn new(fleet: Arc<SharedFleet>, audit: Notes) -> Self {
        Self { fleet, audit }
    }

    /// Tells of a command that is over, where it is worth a line: those to the swarm, and those that
    /// came to nothing.
    pub(super) fn tell(&self, command: &CommandView) {
        self.audit.note(Entry {
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
            .and_then(|id| RobotId::new(id).ok());
        self.fleet.lock().events.push(level, robot, text);
    }
}
