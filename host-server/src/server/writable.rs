//! Whether commands and the audit log can be written, told as events when that changes.

use crawler_commands::CommandCenter;
use crawler_fleet::{Level, SharedFleet};
use crawler_records::audit_log::AuditLog;

/// What was told last.
#[derive(Debug)]
pub(super) struct Writable {
    commands: bool,
    audit: bool,
}

impl Default for Writable {
    /// As long as nothing was told, all is well.
    fn default() -> Self {
        Self {
            commands: true,
            audit: true,
        }
    }
}

impl Writable {
    /// Tells what has changed since the last time.
    pub(super) fn tell(&mut self, commands: &CommandCenter, audit: &AuditLog, fleet: &SharedFleet) {
        let (commands, audit) = (commands.is_written(), audit.is_written());
        if std::mem::replace(&mut self.commands, commands) != commands {
            let text = if commands {
                "commands can be written down again"
            } else {
                "commands cannot be written down: only halts and motion are taken"
            };
            push(fleet, commands, text);
        }
        if std::mem::replace(&mut self.audit, audit) != audit {
            let text = if audit {
                "the audit log can be written again"
            } else {
                "the audit log cannot be written: its lines wait in memory"
            };
            push(fleet, audit, text);
        }
    }
}

fn push(fleet: &SharedFleet, well: bool, text: &str) {
    let level = if well { Level::Info } else { Level::Error };
    fleet.lock().events.push(level, None, text.to_owned());
}
