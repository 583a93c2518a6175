//! What a server holds when everybody rests.

use std::path::Path;
use std::time::Duration;

use super::crowd::CrowdCounts;
use super::follow::Fates;
use crate::Terracrawler;
use crate::measure::{self, sum};

/// What was read behind a cycle.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reading {
    /// Which cycle, from 1 on.
    pub cycle: usize,
    /// Since the beginning.
    pub at: Duration,
    /// Whether the server was started again in it.
    pub restarted: bool,
    /// Resident memory of the server, MiB.
    pub memory_mib: f64,
    /// Open descriptors of the server.
    pub descriptors: u64,
    /// Tasks of the server and of its broker that have not ended.
    pub tasks: [u64; 2],
    /// Messages waiting in the broker, and samples and events on their way to the disk.
    pub queued: u64,
    /// Commands acknowledged in this cycle.
    pub acknowledged: u64,
    /// Commands refused in this cycle, those while the server was down among them.
    pub refused: u64,
    /// Those that must not be lost and came to an end.
    pub ended: u64,
    /// Those that had come to an end before a restart, and were not asked about until then.
    pub forgotten: u64,
    /// Those that were acknowledged and lost.
    pub lost: Vec<String>,
    /// Samples, events and lines of the audit log that the server let go since it was started.
    pub let_go: u64,
    /// Readings of the live feed in this cycle, faults given to robots, and what floods asked for.
    pub crowd: [u64; 3],
    /// Samples in the history since the server was started.
    pub samples: u64,
    /// Bytes of the history on disk.
    pub history_bytes: u64,
    /// Bytes of all else in the data directory.
    pub records_bytes: u64,
}

impl Reading {
    pub(super) fn take(server: &Terracrawler, told: CrowdCounts, fates: Fates) -> Self {
        let text = measure::metrics(server);
        let count = |name: &str| sum(&text, name) as u64;
        let [history_bytes, records_bytes] = sizes(&server.data()).expect("a data directory");
        Self {
            memory_mib: measure::resident_mib(server.id()),
            descriptors: count("process_open_fds"),
            tasks: ["server", "broker"]
                .map(|of| count(&format!("terracrawler_tasks{{runtime=\"{of}\"}}"))),
            queued: count("terracrawler_embedded_broker_queued")
                + count("terracrawler_history_queued")
                + count("terracrawler_events_queued"),
            acknowledged: told.acknowledged,
            refused: told.refused,
            ended: fates.ended,
            forgotten: fates.forgotten,
            lost: fates.lost,
            let_go: count("terracrawler_history_dropped_total")
                + count("terracrawler_events_dropped_total")
                + count("terracrawler_drops_total{reason=\"audit_full\"}"),
            crowd: [told.looks, told.faults, told.floods],
            samples: count("terracrawler_history_written_total"),
            history_bytes,
            records_bytes,
            ..Self::default()
        }
    }

    /// As a row of the table.
    pub fn row(&self) -> String {
        let [server, broker] = self.tasks;
        let [looks, faults, floods] = self.crowd;
        format!(
            "| {}{} | {:.0} | {:.0} | {} | {server}, {broker} | {} | {} | {} | {} | {} | {:.1} | {:.1} | {looks} | \
             {faults} | {floods} |",
            self.cycle,
            if self.restarted { ", restarted" } else { "" },
            self.at.as_secs_f64() / 60.0,
            self.memory_mib,
            self.descriptors,
            self.queued,
            self.acknowledged,
            self.refused,
            self.lost.len(),
            self.let_go,
            self.history_bytes as f64 / 1e6,
            self.records_bytes as f64 / 1e6,
        )
    }
}

/// The heads of the columns.
pub fn table() -> String {
    let heads = [
        "cycle",
        "ended after, min",
        "memory, MiB",
        "descriptors",
        "tasks of server, broker",
        "queued",
        "commands acknowledged",
        "refused",
        "lost",
        "let go",
        "history, MB",
        "records, MB",
        "looks at the live feed",
        "faults",
        "floods: connections, requests",
    ];
    format!(
        "| {} |\n|{}",
        heads.join(" | "),
        "---:|".repeat(heads.len())
    )
}

/// Bytes of the history, and of all else in a data directory.
fn sizes(data: &Path) -> std::io::Result<[u64; 2]> {
    let mut sizes = [0; 2];
    for entry in std::fs::read_dir(data)? {
        let entry = entry?;
        let about = entry.metadata()?;
        let is_history = entry.file_name().to_string_lossy().starts_with("history");
        let bytes = if about.is_dir() {
            sizes_of_folder(&entry.path())?
        } else {
            about.len()
        };
        sizes[usize::from(!is_history)] += bytes;
    }
    Ok(sizes)
}

fn sizes_of_folder(folder: &Path) -> std::io::Result<u64> {
    Ok(sizes(folder)?.iter().sum())
}
