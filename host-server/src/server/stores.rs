//! What the metrics tell of the data directory, of what is written into it, and of what is kept elsewhere.

use std::path::PathBuf;
use std::sync::Arc;

use crawler_history::HistoryStore;
use crawler_records::{DatabaseStats, Records};

use super::cluster_metrics;
use crawler_cluster::ClusterMembership;
use crawler_fleet::recorder::Recorder;
use crawler_metrics::{Exposition, machine};

/// Where things are kept.
pub(super) struct Stores {
    /// The data directory.
    pub(super) data: PathBuf,
    pub(super) history: HistoryStore,
    pub(super) recorder: Recorder,
    pub(super) records: Records,
    /// The other servers, where there may be any.
    pub(super) membership: Option<Arc<ClusterMembership>>,
}

impl Stores {
    /// How they are doing, behind what this process costs.
    pub(super) fn write_metrics(&self, out: &mut Exposition) {
        machine::write_process(out);
        machine::write_data(out, &self.data);
        write_history(out, &self.history);
        self.recorder.write_metrics(out);
        if let Some(stats) = self.records.database() {
            write_database(out, &stats);
        }
        cluster_metrics::write_metrics(out, self.membership.as_deref());
    }
}

/// How the history is doing, in this process or outside.
fn write_history(out: &mut Exposition, history: &HistoryStore) {
    let (counters, queued) = match history {
        HistoryStore::Local(local) => {
            let stats = local.stats();
            out.flag(
                "terracrawler_history_kept",
                "1 while this process writes the history",
                stats.keeper,
            );
            let damaged = ("damaged", "Blocks that could not be read", stats.damaged);
            let taken = [stats.accepted, stats.written, stats.dropped, stats.failures];
            ((taken, damaged), stats.queued)
        }
        HistoryStore::Engine(engine) => {
            let stats = engine.stats();
            out.flag(
                "terracrawler_history_engine_up",
                "1 while the engine outside takes samples",
                stats.up,
            );
            let refused = ("refused", "Samples that the engine refused", stats.refused);
            let taken = [stats.accepted, stats.written, stats.dropped, stats.failures];
            ((taken, refused), stats.queued)
        }
    };
    let ([accepted, written, dropped, failures], own) = counters;
    for (name, help, value) in [
        (
            "accepted",
            "Telemetry samples taken for the history",
            accepted,
        ),
        (
            "written",
            "Samples that are on disk, or with the engine outside",
            written,
        ),
        (
            "dropped",
            "Samples let go because too many were waiting",
            dropped,
        ),
        (
            "failures",
            "Writes that failed and were tried again",
            failures,
        ),
        own,
    ] {
        out.counter(&format!("terracrawler_history_{name}"), help, value as f64);
    }
    out.gauge(
        "terracrawler_history_queued",
        "Samples waiting to be written",
        queued as f64,
    );
}

/// How the database of the records is doing.
fn write_database(out: &mut Exposition, stats: &DatabaseStats) {
    out.flag(
        "terracrawler_database_up",
        "1 while the database of the records answers",
        stats.up,
    );
    out.gauge(
        "terracrawler_database_queued",
        "Changes waiting to be written to it",
        stats.queued as f64,
    );
    for (name, help, value) in [
        (
            "transactions",
            "Transactions that it committed for this server",
            stats.transactions as f64,
        ),
        (
            "transaction_seconds",
            "Time that those took, with the wait for other servers",
            stats.waited.as_secs_f64(),
        ),
        (
            "failures",
            "Calls that failed because it was not available",
            stats.failures as f64,
        ),
    ] {
        out.counter(&format!("terracrawler_database_{name}"), help, value);
    }
}
