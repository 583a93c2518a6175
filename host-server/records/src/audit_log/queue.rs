//! Entries of the audit log on their way to the records.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::{Entry, RecordsError};
use tokio::sync::{Notify, oneshot};

use crawler_metrics::{Dropped, Metrics};

/// Entries that wait to be written, at most.
pub(crate) const MOST: usize = 4_096;

struct Waiting {
    entry: Entry,
    /// Whoever waits for it.
    written: Option<oneshot::Sender<()>>,
}

/// Entries for which there was no room, one after the other.
struct Gap {
    entries: u64,
    from: i64,
    to: i64,
}

#[derive(Default)]
struct State {
    entries: VecDeque<Waiting>,
    /// What is missing behind them.
    gap: Option<Gap>,
    /// The records did not take the last batch.
    failing: bool,
    /// Nobody writes any more.
    ended: bool,
}

/// See the [module](self).
pub(crate) struct Queue {
    state: Mutex<State>,
    added: Notify,
    metrics: Arc<Metrics>,
}

impl Queue {
    pub(crate) fn new(metrics: Arc<Metrics>) -> Self {
        metrics.audit.written(true, 0);
        Self {
            state: Mutex::default(),
            added: Notify::new(),
            metrics,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an entry. One too many makes a gap, or a longer one.
    pub(crate) fn push(&self, entry: Entry) {
        self.add(entry, None);
    }

    /// Adds an entry and returns when it is written, or when it is known that it waits.
    ///
    /// # Cancellation safety
    /// It is written all the same.
    pub(crate) async fn push_and_wait(&self, entry: Entry) {
        let (written, waits) = oneshot::channel();
        self.add(entry, Some(written));
        // An error says that it was not written for now.
        let _ = waits.await;
    }

    fn add(&self, entry: Entry, written: Option<oneshot::Sender<()>>) {
        let mut state = self.state();
        if state.ended {
            tracing::error!(action = entry.action, "a line of the audit log is lost");
            return;
        }
        if state.entries.len() + 2 <= MOST {
            state.write_gap();
        }
        if state.gap.is_some() || state.entries.len() >= MOST {
            self.metrics.dropped(Dropped::AuditFull);
            let gap = state.gap.get_or_insert_with(|| {
                tracing::error!("too many lines of the audit log wait: from here on they are lost");
                Gap {
                    entries: 0,
                    from: entry.at,
                    to: entry.at,
                }
            });
            gap.entries += 1;
            gap.to = entry.at;
            return;
        }
        let written = written.filter(|_| !state.failing);
        state.entries.push_back(Waiting { entry, written });
        drop(state);
        self.added.notify_one();
    }

    /// Returns when something was added.
    pub(crate) async fn added(&self) {
        self.added.notified().await;
    }

    /// The first entries; they stay until they are [written](Queue::written).
    pub(crate) fn batch(&self, most: usize) -> Vec<Entry> {
        let mut state = self.state();
        if state.entries.is_empty() {
            state.write_gap();
        }
        let first = state.entries.iter().take(most);
        first.map(|waiting| waiting.entry.clone()).collect()
    }

    /// The first `count` entries are in the records.
    pub(crate) fn written(&self, count: usize) {
        let mut state = self.state();
        if std::mem::take(&mut state.failing) {
            tracing::info!("the audit log can be written again");
        }
        let count = count.min(state.entries.len());
        let done: Vec<_> = state.entries.drain(..count).collect();
        self.metrics.audit.written(true, state.entries.len());
        drop(state);
        for written in done.into_iter().filter_map(|waiting| waiting.written) {
            // Whoever does not wait any more need not be told.
            let _ = written.send(());
        }
    }

    /// The records did not take the first entries.
    pub(crate) fn failed(&self, error: &RecordsError) {
        let mut state = self.state();
        if !std::mem::replace(&mut state.failing, true) {
            tracing::error!(%error, "the audit log cannot be written: its lines wait in memory");
        }
        state.let_go();
        self.metrics.audit.failed();
        self.metrics.audit.written(false, state.entries.len());
    }

    /// Takes nothing more.
    pub(crate) fn end(&self) {
        let mut state = self.state();
        state.ended = true;
        state.let_go();
        let lost = state.entries.len() as u64 + state.gap.as_ref().map_or(0, |gap| gap.entries);
        if lost > 0 {
            tracing::error!(
                lost,
                "lines of the audit log were not written before the end"
            );
        }
    }

    pub(crate) fn is_failing(&self) -> bool {
        self.state().failing
    }

    pub(crate) fn is_half_empty(&self) -> bool {
        self.state().entries.len() < MOST / 2
    }
}

impl State {
    /// Has a gap written down, in its place.
    fn write_gap(&mut self) {
        if let Some(gap) = self.gap.take() {
            self.entries.push_back(Waiting {
                entry: Entry::gap(gap.entries, gap.from, gap.to),
                written: None,
            });
        }
    }

    /// Lets everybody go who waits for an entry.
    fn let_go(&mut self) {
        for waiting in &mut self.entries {
            waiting.written = None;
        }
    }
}
