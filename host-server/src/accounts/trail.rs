//! The audit log: who did what, when, from where, and what came of it.

use std::sync::Arc;
use std::time::Duration;

use crawler_records::{Records, RecordsError};
use futures_util::future::join_all;
use serde_json::Value;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::now_ms;
use crate::metrics::{Dropped, Metrics};

/// Entries that wait to be written.
const QUEUE: usize = 4_096;
/// Those that are written at a time: the records put them into one transaction.
const BATCH: usize = 128;
/// Before an entry is tried again that a database did not take.
const AGAIN: Duration = Duration::from_secs(1);

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

/// Notes lines of the log, for whoever cannot wait. A handle.
#[derive(Clone)]
pub(crate) struct Notes {
    queue: mpsc::Sender<crawler_records::Entry>,
    metrics: Arc<Metrics>,
}

impl Notes {
    /// Notes a line.
    pub(crate) fn note(&self, entry: Entry) {
        if let Err(error) = self.queue.try_send(entry.into_record()) {
            self.metrics.dropped(Dropped::AuditFull);
            missing(&error);
        }
    }
}

/// Writes to the log.
pub(crate) struct Trail {
    records: Records,
    notes: Notes,
}

/// What writes the lines that are only noted.
pub(crate) struct Writer {
    records: Records,
    waiting: mpsc::Receiver<crawler_records::Entry>,
}

impl Trail {
    /// A log in `records`, and what is to run for as long as it is used.
    pub(crate) fn new(records: Records, metrics: Arc<Metrics>) -> (Self, Writer) {
        let (queue, waiting) = mpsc::channel(QUEUE);
        let writer = Writer {
            records: records.clone(),
            waiting,
        };
        let notes = Notes { queue, metrics };
        (Self { records, notes }, writer)
    }

    /// For others who cannot wait.
    pub(crate) fn notes(&self) -> Notes {
        self.notes.clone()
    }

    /// Writes a line and returns when it is on disk. What was done is done by then: an answer that
    /// says otherwise would be wrong, so a failure is logged. A line that a database does not take for
    /// now is written when it does; rather twice than never.
    pub(crate) async fn write(&self, entry: Entry) {
        let entry = entry.into_record();
        match self.records.audit(entry.clone()).await {
            Err(error) if error.is_passing() => {
                if self.notes.queue.try_send(entry).is_err() {
                    self.notes.metrics.dropped(Dropped::AuditFull);
                    missing(&error);
                }
            }
            Err(error) => missing(&error),
            Ok(_) => {}
        }
    }

    /// Notes a line, for whoever cannot wait.
    pub(crate) fn note(&self, entry: Entry) {
        self.notes.note(entry);
    }
}

impl Writer {
    /// Writes what is noted, until `stop` and until nothing waits any more.
    pub(crate) async fn run(self, stop: CancellationToken) {
        keep(self.records, self.waiting, stop).await;
    }
}

async fn keep(
    records: Records,
    mut waiting: mpsc::Receiver<crawler_records::Entry>,
    stop: CancellationToken,
) {
    let mut batch = Vec::with_capacity(BATCH);
    loop {
        let taken = tokio::select! {
            biased;
            taken = waiting.recv_many(&mut batch, BATCH) => taken,
            () = stop.cancelled() => 0,
        };
        if taken == 0 {
            return;
        }
        // Handed over in their order, which the records keep.
        let written = join_all(batch.iter().map(|entry| records.audit(entry.clone()))).await;
        let left = batch.drain(..).zip(written);
        for entry in left.filter_map(|(entry, written)| unwritten(entry, written)) {
            write(&records, entry, &stop).await;
        }
    }
}

/// An entry that is to be tried again.
fn unwritten<T>(
    entry: crawler_records::Entry,
    written: Result<T, RecordsError>,
) -> Option<crawler_records::Entry> {
    match written {
        Err(error) if error.is_passing() => Some(entry),
        Err(error) => {
            missing(&error);
            None
        }
        Ok(_) => None,
    }
}

/// Tries until the records take it.
async fn write(records: &Records, entry: crawler_records::Entry, stop: &CancellationToken) {
    while let Err(error) = records.audit(entry.clone()).await {
        if !error.is_passing() || stop.is_cancelled() {
            missing(&error);
            break;
        }
        tokio::select! {
            () = stop.cancelled() => {}
            () = tokio::time::sleep(AGAIN) => {}
        }
    }
}

fn missing(error: &dyn std::fmt::Display) {
    tracing::error!(%error, "a line of the audit log is lost");
}
