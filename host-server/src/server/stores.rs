//! What the metrics tell of the data directory, of what is written into it, and of what is kept elsewhere.

use std::path::PathBuf;
use std::sync::Arc;

use crawler_records::{DatabaseStats, Records};

use super::cluster_metrics;
use crate::history::History;
use crawler_cluster::ClusterMembership;
use crawler_fleet::recorder::Recorder;
use crawler_metrics::{Exposition, machine};

/// Where things are kept.
pub(super) struct Stores {
    /// The data directory.
    pub(super) data: PathBuf,
    pub(super) history: History,
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
        self.history.write_metrics(out);
        self.recorder.write_metrics(out);
        if let Some(stats) = self.records.database() {
            write_database(out, &stats);
        }
        cluster_metrics::write_metrics(out, self.membership.as_deref());
    }
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
