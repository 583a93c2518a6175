//! Going on where the last server ended.

use std::sync::Arc;
use std::time::Instant;

use super::journal::{Journal, JournalQueue};
use super::pending::Pending;
use super::{CommandCenter, sequence};
use crawler_system::clock;
use crawler_system::data::{DataDir, DataError};

/// File of commands that robots are owed, in the data directory.
const FILE: &str = "commands";

impl Journal {
    /// Opens the journal of a server.
    ///
    /// # Errors
    /// [`DataError`] when the file cannot be read or written.
    pub fn of(data: &DataDir) -> Result<Self, DataError> {
        Self::open(&data.file(FILE), data.disk()).map_err(|cause| data.failed(FILE, cause))
    }
}

impl CommandCenter {
    /// Goes on with what the last server owed, and writes down what this one does.
    ///
    /// # Errors
    /// [`DataError`] when nothing can be written down.
    pub fn with_journal(
        self,
        journal: Journal,
        data: &Arc<DataDir>,
        now: Instant,
    ) -> Result<Self, DataError> {
        {
            let mut book = self.book();
            let book = &mut *book;
            let (unix, at) = (clock::unix_ms(), self.ms(now));
            let mut stale = Vec::new();
            for owed in journal.owed() {
                let Some(pending) = Pending::of_entry(owed, now) else {
                    tracing::warn!(id = owed.id, "an invalid command is in the journal");
                    continue;
                };
                let (class, left) = (pending.class(), pending.left_ms(unix));
                if left == 0 {
                    let legs = pending.legs.into_iter();
                    stale.extend(legs.map(|(robot, _)| (owed.id, robot)));
                    continue;
                }
                for leg in pending.legs {
                    book.resume(owed.id, class, leg, at, left);
                }
                book.remember(pending.record);
            }
            let commands = book.delivery.len();
            if commands > 0 {
                tracing::info!(commands, "commands of the last run to deliver");
            }
            // Before there is a thread: nothing after it fails.
            if let Some(number) = book.table.sequence.reserve_first() {
                data.set_number(sequence::FILE, number)?;
            }
            let metrics = Arc::clone(&self.metrics);
            let queue = journal
                .start(Arc::clone(data), sequence::FILE, metrics)
                .map_err(|cause| data.failed(FILE, cause))?;
            book.table.sequence.write_to(queue.lines());
            book.table.journal = Some(queue);
            for (id, robot) in stale {
                book.table.done(id, &robot);
            }
        }
        Ok(self)
    }

    /// Has everything written down once it is polled, and returns when it is. From there on only halts and
    /// motion are taken, and the data directory is not written any more.
    ///
    /// # Cancellation safety
    /// It is written all the same.
    pub fn close(&self) -> impl Future<Output = ()> + Send + use<> {
        let book = self.book();
        let lines = book.table.journal.as_ref().map(JournalQueue::lines);
        let lines = lines.map(Arc::clone);
        async move {
            if let Some(lines) = lines {
                lines.end().cancelled().await;
            }
        }
    }

    /// Whether commands that are to outlive the server can be written down.
    pub fn is_written(&self) -> bool {
        let book = self.book();
        let journal = book.table.journal.as_ref();
        journal.is_none_or(|journal| !journal.lines().is_failing())
    }
}
