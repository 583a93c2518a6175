//! Where those who push, the task that writes, and those who ask meet.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crawler_history::{EngineStats, Full, Sample};
use tokio::sync::{Notify, watch};

use crate::engine::Engine;
use crate::error::EngineError;

/// Most samples in one request: at about 160 bytes each, some 1.6 MB. Every request costs an engine a
/// visit to its disk, so what piled up goes in few of them.
pub const BATCH: usize = 10_000;
/// Samples that are worth a request before the tick.
pub(crate) const MANY: usize = 5_000;

/// How it stands with the engine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum State {
    /// It has not answered yet.
    Connecting,
    /// It takes samples.
    Up,
    /// It does not, for this reason. Samples wait, and it is tried again.
    Down(EngineError),
}

#[derive(Debug)]
struct Inbox {
    open: bool,
    samples: VecDeque<Sample>,
    accepted: u64,
    /// Of those, samples that do not wait any more, whatever became of them.
    settled: u64,
}

/// How far the writer is.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Progress {
    pub(crate) settled: u64,
    pub(crate) closed: bool,
}

#[derive(Debug)]
pub(crate) struct Shared {
    inbox: Mutex<Inbox>,
    /// Most samples that wait.
    limit: u64,
    pub(crate) wake: Notify,
    pub(crate) progress: watch::Sender<Progress>,
    state: Mutex<(State, Option<Engine>)>,
    dropped: AtomicU64,
    refused: AtomicU64,
    written: AtomicU64,
    failures: AtomicU64,
}

impl Shared {
    pub(crate) fn new(limit: usize) -> Self {
        Self {
            inbox: Mutex::new(Inbox {
                open: true,
                samples: VecDeque::new(),
                accepted: 0,
                settled: 0,
            }),
            limit: limit as u64,
            wake: Notify::new(),
            progress: watch::Sender::default(),
            state: Mutex::new((State::Connecting, None)),
            dropped: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            written: AtomicU64::new(0),
            failures: AtomicU64::new(0),
        }
    }

    /// A panic of somebody else leaves nothing half done in here: the lock is taken all the same.
    fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn state_lock(&self) -> MutexGuard<'_, (State, Option<Engine>)> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn push(&self, sample: Sample) -> Result<(), Full> {
        let mut inbox = self.inbox();
        if !inbox.open || inbox.accepted - inbox.settled >= self.limit {
            drop(inbox);
            self.dropped.fetch_add(1, Ordering::Relaxed);
            return Err(Full);
        }
        inbox.samples.push_back(sample);
        inbox.accepted += 1;
        let many = inbox.samples.len() == MANY;
        drop(inbox);
        if many {
            self.wake.notify_one();
        }
        Ok(())
    }

    /// The oldest samples in the queue, at most a batch.
    pub(crate) fn take(&self) -> Vec<Sample> {
        let mut inbox = self.inbox();
        let count = inbox.samples.len().min(BATCH);
        inbox.samples.drain(..count).collect()
    }

    /// Samples in the queue, without those taken.
    pub(crate) fn waiting(&self) -> usize {
        self.inbox().samples.len()
    }

    pub(crate) fn accepted(&self) -> u64 {
        self.inbox().accepted
    }

    /// Of the samples that were taken, so many are written and refused now.
    pub(crate) fn settle(&self, written: u64, refused: u64) {
        self.written.fetch_add(written, Ordering::Relaxed);
        self.refused.fetch_add(refused, Ordering::Relaxed);
        let settled = {
            let mut inbox = self.inbox();
            inbox.settled += written + refused;
            inbox.settled
        };
        self.progress
            .send_modify(|progress| progress.settled = settled);
    }

    /// Takes nothing more.
    pub(crate) fn shut(&self) {
        self.inbox().open = false;
    }

    /// Lets go of everything that waits, and returns how much that was.
    pub(crate) fn close(&self) -> u64 {
        let lost = {
            let mut inbox = self.inbox();
            inbox.open = false;
            inbox.samples = VecDeque::new();
            let lost = inbox.accepted - inbox.settled;
            inbox.settled = inbox.accepted;
            lost
        };
        self.dropped.fetch_add(lost, Ordering::Relaxed);
        self.set_state(State::Down(EngineError::Closed));
        self.progress.send_modify(|progress| progress.closed = true);
        lost
    }

    pub(crate) fn failed(&self, error: EngineError) {
        self.failures.fetch_add(1, Ordering::Relaxed);
        self.set_state(State::Down(error));
    }

    pub(crate) fn set_state(&self, state: State) {
        self.state_lock().0 = state;
    }

    pub(crate) fn met(&self, engine: Engine) {
        self.state_lock().1 = Some(engine);
    }

    pub(crate) fn state(&self) -> State {
        self.state_lock().0.clone()
    }

    pub(crate) fn engine(&self) -> Option<Engine> {
        self.state_lock().1.clone()
    }

    pub(crate) fn stats(&self) -> EngineStats {
        let (accepted, queued) = {
            let inbox = self.inbox();
            (inbox.accepted, inbox.accepted - inbox.settled)
        };
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        EngineStats {
            accepted,
            dropped: count(&self.dropped),
            written: count(&self.written),
            refused: count(&self.refused),
            queued,
            failures: count(&self.failures),
            up: self.state_lock().0 == State::Up,
        }
    }
}
