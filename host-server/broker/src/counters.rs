//! What the broker has refused so far.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use super::accounts::Refusal;
use crawler_records::audit_log::Notes;

/// A line of log about a refusal at most so often: whoever is refused comes again at once.
const SAY_EVERY: Duration = Duration::from_secs(1);

/// What the guard has done so far.
#[derive(Default)]
pub(crate) struct GuardCounters {
    /// Publishes refused because of their size.
    pub(crate) oversize: AtomicU64,
    /// Publishes refused because they wanted to be retained where nothing is.
    pub(crate) retain_refused: AtomicU64,
    /// Messages not retained because the storage is full.
    pub(crate) not_retained: AtomicU64,
    /// Publishes that had to wait because their client was over its budget.
    pub(crate) delayed: AtomicU64,
    /// Connections refused, whatever for.
    pub(crate) refused: AtomicU64,
    /// Sessions ended because their client stayed over its budget.
    pub(crate) cut_off: AtomicU64,
    /// Sessions ended because their account or credential no longer counts.
    pub(crate) dropped: AtomicU64,
    /// The audit log, once there is one.
    pub(crate) notes: OnceLock<Notes>,
    reasons: [AtomicU64; Refusal::ALL.len()],
    said: Mutex<Option<Instant>>,
}

impl GuardCounters {
    /// Counts one refusal of something that a session wanted.
    pub(crate) fn refuse(&self, reason: Refusal) {
        if let Some(count) = self.reasons.get(reason as usize) {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Counts a connection that was refused. True when it is time for a line of log.
    pub(crate) fn refuse_connection(&self, reason: Refusal, now: Instant) -> bool {
        self.refused.fetch_add(1, Ordering::Relaxed);
        self.refuse(reason);
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let due = said.is_none_or(|at| now.saturating_duration_since(at) >= SAY_EVERY);
        if due {
            *said = Some(now);
        }
        due
    }

    /// Every reason with how often it was given.
    pub(crate) fn refusals(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        Refusal::ALL
            .into_iter()
            .zip(&self.reasons)
            .map(|(reason, count)| (reason.name(), count.load(Ordering::Relaxed)))
    }
}
