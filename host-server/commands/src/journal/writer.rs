//! The thread that the journal belongs to.

use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::queue::{Batch, Job, Lines};
use super::{Journal, JournalQueue, Line};
use crawler_metrics::Metrics;
use crawler_system::data::DataDir;

/// Before what could not be written is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// What the thread has.
pub(super) struct Writer {
    pub(super) journal: Journal,
    /// Ours for as long as something is written into it.
    pub(super) data: Arc<DataDir>,
    /// File of the numbers that are kept free.
    pub(super) numbers: &'static str,
    /// Up to where they are to be, if the file does not say so yet.
    pub(super) reserve: Option<u64>,
    pub(super) metrics: Arc<Metrics>,
}

impl Writer {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the operating system gives none.
    pub(super) fn start(self) -> io::Result<JournalQueue> {
        let lines = Arc::new(Lines::default());
        let queue = JournalQueue::new(Arc::clone(&lines), self.journal.owed());
        self.metrics.journal_up(true);
        let thread = std::thread::Builder::new().name("journal".to_owned());
        thread.spawn(move || self.run(&lines))?;
        Ok(queue)
    }

    fn run(mut self, lines: &Lines) {
        loop {
            let again = lines.is_failing().then_some(AGAIN);
            let batch = lines.next(again);
            let last = batch.last;
            self.step(batch, lines);
            if last {
                break;
            }
        }
        let ended = lines.ended.clone();
        // The directory is somebody else's from here on.
        drop(self);
        ended.cancel();
    }

    /// Writes what there is, and tells whoever waits for it.
    pub(super) fn step(&mut self, batch: Batch, lines: &Lines) {
        let mut told = Vec::new();
        let mut new = Vec::new();
        for job in batch.jobs {
            match job {
                Job::Line(line) => new.push(line),
                Job::Accept(owed, sender) => {
                    new.push(Line::Accepted(owed));
                    told.push(sender);
                }
                Job::Clear => {
                    new.clear();
                    told.clear();
                    self.journal.clear();
                }
            }
        }
        self.reserve = self.reserve.max(batch.reserve);
        let written = self.write(new);
        let failed = lines.failing.swap(written.is_err(), Ordering::AcqRel);
        self.metrics.journal_up(written.is_ok());
        match written {
            Ok(()) => {
                if failed {
                    tracing::info!("commands can be written down again");
                }
                lines.safe.store(batch.count, Ordering::Release);
                for sender in told {
                    // Whoever does not wait any more need not be told.
                    let _ = sender.send(());
                }
            }
            Err(error) => {
                self.metrics.journal_failed();
                if !failed {
                    tracing::error!(%error, "commands cannot be written down: only halts and motion \
                        are accepted");
                }
                // Dropped unused, `told` says that it was in vain.
            }
        }
    }

    fn write(&mut self, lines: Vec<Line>) -> io::Result<()> {
        if let Err(error) = self.keep_free() {
            self.journal.remember(lines);
            return Err(error);
        }
        self.journal.write(lines)
    }

    /// Keeps numbers free. What is accepted under one that is not could meet it again after a crash.
    fn keep_free(&mut self) -> io::Result<()> {
        if let Some(number) = self.reserve {
            let set = self.data.set_number(self.numbers, number);
            set.map_err(io::Error::other)?;
            self.reserve = None;
        }
        Ok(())
    }
}

impl Journal {
    /// Gives the file to a thread that writes what comes through the queue. `numbers` is the file, in
    /// `data`, of the numbers that are kept free.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub(crate) fn start(
        self,
        data: Arc<DataDir>,
        numbers: &'static str,
        metrics: Arc<Metrics>,
    ) -> io::Result<JournalQueue> {
        let writer = Writer {
            journal: self,
            data,
            numbers,
            reserve: None,
            metrics,
        };
        writer.start()
    }
}
