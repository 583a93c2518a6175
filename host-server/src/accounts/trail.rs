//! The audit log: who did what, when, from where, and what came of it.

use crawler_records::Records;
use serde_json::Value;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::now_ms;

/// Entries that wait to be written.
const QUEUE: usize = 4_096;

/// One line of the log.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    /// The account, or what did it.
    pub(crate) who: String,
    /// The address it came from; empty where it came from the server itself.
    pub(crate) from: String,
    /// What was done, like `command.send`.
    pub(crate) action: &'static str,
    /// To what.
    pub(crate) target: String,
    /// How, in detail.
    pub(crate) detail: Value,
    /// What came of it: `ok`, or a stable code.
    pub(crate) outcome: String,
}

impl Entry {
    fn into_record(self) -> crawler_records::Entry {
        crawler_records::Entry {
            at: now_ms(),
            who: self.who,
            from: self.from,
            action: self.action.to_owned(),
            // What somebody wrote in an address may be long.
            target: self.target.chars().take(100).collect(),
            detail: self.detail,
            outcome: self.outcome,
        }
    }
}

/// Writes to the log.
pub(crate) struct Trail {
    records: Records,
    queue: mpsc::Sender<crawler_records::Entry>,
}

impl Trail {
    /// A log in `records`, and the task that writes what is only noted. It ends some time after
    /// `stop`, when nothing waits any more.
    pub(crate) fn new(records: Records, stop: CancellationToken) -> (Self, JoinHandle<()>) {
        let (queue, waiting) = mpsc::channel(QUEUE);
        let task = tokio::spawn(keep(records.clone(), waiting, stop));
        (Self { records, queue }, task)
    }

    /// Writes a line and returns when it is on disk. What was done is done by then: an answer that
    /// says otherwise would be wrong, so a failure is logged.
    pub(crate) async fn write(&self, entry: Entry) {
        if let Err(error) = self.records.audit(entry.into_record()).await {
            missing(&error);
        }
    }

    /// Notes a line, for whoever cannot wait.
    pub(crate) fn note(&self, entry: Entry) {
        if let Err(error) = self.queue.try_send(entry.into_record()) {
            missing(&error);
        }
    }
}

async fn keep(
    records: Records,
    mut waiting: mpsc::Receiver<crawler_records::Entry>,
    stop: CancellationToken,
) {
    loop {
        let entry = tokio::select! {
            biased;
            entry = waiting.recv() => entry,
            () = stop.cancelled() => None,
        };
        let Some(entry) = entry else {
            return;
        };
        if let Err(error) = records.audit(entry).await {
            missing(&error);
        }
    }
}

fn missing(error: &dyn std::fmt::Display) {
    tracing::error!(%error, "a line of the audit log is lost");
}
