//! Why something was let go.

/// Why the server let something go, because a queue was full, a budget was spent, or it came too late.
/// `docs/monitor.md` says what each means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dropped {
    /// A reader of the live feed fell behind.
    SlowReader,
    /// Too many samples wait to be written into the history.
    HistoryFull,
    /// Too many messages wait for the connection to the broker.
    OutboxFull,
    /// Too many commands wait for robots.
    CommandsFull,
    /// A command found no robot while it was worth something.
    CommandExpired,
    /// Too many lines wait to be written into the audit log.
    AuditFull,
    /// Too many samples of robots and fixes of trackers wait for their twins.
    TwinsFull,
    /// An address or a user asks for too much.
    RateLimited,
}

impl Dropped {
    /// Every reason.
    pub(crate) const ALL: [Self; 8] = [
        Self::SlowReader,
        Self::HistoryFull,
        Self::OutboxFull,
        Self::CommandsFull,
        Self::CommandExpired,
        Self::AuditFull,
        Self::TwinsFull,
        Self::RateLimited,
    ];

    /// The value of the label.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::SlowReader => "slow_reader",
            Self::HistoryFull => "history_full",
            Self::OutboxFull => "outbox_full",
            Self::CommandsFull => "commands_full",
            Self::CommandExpired => "command_expired",
            Self::AuditFull => "audit_full",
            Self::TwinsFull => "twins_full",
            Self::RateLimited => "rate_limited",
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn every_reason_is_explained_and_there_before_it_happens() {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/monitor.md");
        let page = std::fs::read_to_string(page).expect("docs/monitor.md");
        let metrics = crate::Metrics::new();
        metrics.dropped(Dropped::AuditFull);
        let text = metrics.exposition().finish();
        for reason in Dropped::ALL {
            let name = reason.name();
            assert!(page.contains(&format!("| `{name}` |")), "{name}");
            let count = u32::from(reason == Dropped::AuditFull);
            let line = format!("terracrawler_drops_total{{reason=\"{name}\"}} {count}\n");
            assert!(text.contains(&line), "{line} is not in {text}");
        }
    }
}
