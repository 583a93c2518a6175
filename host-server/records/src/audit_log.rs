//! The audit log: who did what, when, from where, and what came of it.
//!
//! One task writes, in the order in which entries came. What the records do not take for now waits in memory
//! and is tried again. Entries for which there is no room there leave a gap, which is written down in its
//! place as an entry of its own.

mod queue;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::Duration;

use crate::{Records, RecordsError};
use serde_json::Value;
use tokio_util::sync::CancellationToken;

use crawler_metrics::Metrics;
use crawler_system::clock::now_ms;
use queue::Queue;

/// Entries that are written at a time, in one transaction.
const BATCH: usize = 128;
/// Before what the records did not take is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// One line of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The account, or what did it.
    pub who: String,
    /// The address it came from; empty where it came from the server itself.
    pub from: String,
    /// What was done, like `command.send`.
    pub action: &'static str,
    /// To what.
    pub target: String,
    /// How, in detail.
    pub detail: Value,
    /// What came of it: `ok`, or a stable code.
    pub outcome: String,
}

impl Entry {
    fn into_record(self) -> crate::Entry {
        crate::Entry {
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

/// Notes lines of the log, for whoever cannot wait. A handle.
#[derive(Clone)]
pub struct Notes(Arc<Queue>);

impl Notes {
    /// Notes a line.
    pub fn note(&self, entry: Entry) {
        self.0.push(entry.into_record());
    }
}

/// Writes to the log.
pub struct AuditLog {
    notes: Notes,
    /// Whether the records are in a file, and not in a database that others bring back.
    in_file: bool,
}

impl AuditLog {
    /// A log in `records`, and what is to run for as long as it is used.
    pub fn new(records: Records, metrics: Arc<Metrics>) -> (Self, AuditWriter) {
        let queue = Arc::new(Queue::new(metrics));
        let audit = Self {
            notes: Notes(Arc::clone(&queue)),
            in_file: records.database().is_none(),
        };
        (audit, AuditWriter { records, queue })
    }

    /// For others who cannot wait.
    pub fn notes(&self) -> Notes {
        self.notes.clone()
    }

    /// Writes a line and returns when it is on disk, or is known not to be for now: it waits in memory
    /// then. What was done is done, so an answer that says otherwise would be wrong. An answer of a
    /// database may be lost: a line is there rather twice than never.
    ///
    /// # Cancellation safety
    /// It is written all the same.
    pub async fn write(&self, entry: Entry) {
        self.notes.0.push_and_wait(entry.into_record()).await;
    }

    /// Notes a line, for whoever cannot wait.
    pub fn note(&self, entry: Entry) {
        self.notes.note(entry);
    }

    /// Whether the records took what was written last.
    pub fn is_written(&self) -> bool {
        !self.notes.0.is_failing()
    }

    /// Whether something may be done that has to be in the log. A file that takes nothing says that the
    /// disk is full. A database that is away comes back, and until then half of the memory is for those
    /// who may wait; the rest is for halts and motion.
    pub fn has_room(&self) -> bool {
        (self.is_written() || !self.in_file) && self.notes.0.is_half_empty()
    }
}

/// What writes the lines.
pub struct AuditWriter {
    records: Records,
    queue: Arc<Queue>,
}

impl AuditWriter {
    /// Writes what comes in, until `stop` and until nothing waits that the records take.
    pub async fn run(self, stop: CancellationToken) {
        loop {
            let batch = self.queue.batch(BATCH);
            if batch.is_empty() {
                if stop.is_cancelled() {
                    return;
                }
                tokio::select! {
                    () = stop.cancelled() => {}
                    () = self.queue.added() => {}
                }
                continue;
            }
            let count = batch.len();
            match self.records.audit().append_all(batch).await {
                Ok(()) => self.queue.written(count),
                Err(error) => {
                    self.queue.failed(&error);
                    if stop.is_cancelled() || matches!(error, RecordsError::Closed) {
                        return;
                    }
                    tokio::select! {
                        () = stop.cancelled() => {}
                        () = tokio::time::sleep(AGAIN) => {}
                    }
                }
            }
        }
    }
}

impl Drop for AuditWriter {
    fn drop(&mut self) {
        self.queue.end();
    }
}
