//! How the database is doing, and whether it is worth asking.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::RecordsError;

/// For so long nobody asks again after it could not be reached: many callers that each wait for the
/// same would only be late.
const PAUSE: Duration = Duration::from_millis(500);

/// How a database of several servers is doing, since it was opened.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DatabaseStats {
    /// Whether the last call came through.
    pub up: bool,
    /// Writes that wait.
    pub queued: u64,
    /// Transactions that were committed.
    pub transactions: u64,
    /// How long they took altogether, with the wait for other servers.
    pub waited: Duration,
    /// Calls and transactions that failed because the database was not available.
    pub failures: u64,
}

#[derive(Debug)]
pub(super) struct Health {
    up: AtomicBool,
    transactions: AtomicU64,
    microseconds: AtomicU64,
    failures: AtomicU64,
    /// When it could not be reached, and why.
    unreachable: Mutex<Option<(Instant, RecordsError)>>,
}

impl Default for Health {
    fn default() -> Self {
        Self {
            up: AtomicBool::new(true),
            transactions: AtomicU64::new(0),
            microseconds: AtomicU64::new(0),
            failures: AtomicU64::new(0),
            unreachable: Mutex::new(None),
        }
    }
}

impl Health {
    pub(super) fn stats(&self, queued: u64) -> DatabaseStats {
        DatabaseStats {
            up: self.up.load(Ordering::Relaxed),
            queued,
            transactions: self.transactions.load(Ordering::Relaxed),
            waited: Duration::from_micros(self.microseconds.load(Ordering::Relaxed)),
            failures: self.failures.load(Ordering::Relaxed),
        }
    }

    /// An error while it is of no use to ask.
    pub(super) fn refused(&self) -> Result<(), RecordsError> {
        let unreachable = self
            .unreachable
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        match &*unreachable {
            Some((at, error)) if at.elapsed() < PAUSE => Err(error.clone()),
            _ => Ok(()),
        }
    }

    /// There is no connection, and why. Returns that.
    pub(super) fn unreachable(&self, error: RecordsError) -> RecordsError {
        if !matches!(error, RecordsError::Closed) {
            self.failed();
            *self
                .unreachable
                .lock()
                .unwrap_or_else(PoisonError::into_inner) = Some((Instant::now(), error.clone()));
        }
        error
    }

    /// What came of a call.
    pub(super) fn note<T>(&self, outcome: &Result<T, RecordsError>) {
        match outcome {
            Err(error) if error.is_passing() => self.failed(),
            // Told by `unreachable`, or nobody's business.
            Err(RecordsError::Refused(_) | RecordsError::Closed) => {}
            _ => self.up.store(true, Ordering::Relaxed),
        }
    }

    /// What came of a transaction, which took so long.
    pub(super) fn transaction(&self, outcome: &Result<(), RecordsError>, took: Duration) {
        self.note(outcome);
        if outcome.is_ok() {
            self.transactions.fetch_add(1, Ordering::Relaxed);
            let took = took.as_micros().try_into().unwrap_or(u64::MAX);
            self.microseconds.fetch_add(took, Ordering::Relaxed);
        }
    }

    fn failed(&self) {
        self.up.store(false, Ordering::Relaxed);
        self.failures.fetch_add(1, Ordering::Relaxed);
    }
}
