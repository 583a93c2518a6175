//! Which tasks were woken.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Wake, Waker};

#[derive(Debug, Default)]
pub(super) struct ReadyList {
    pub(super) tasks: Vec<u32>,
    /// Woken when a task becomes ready while the scheduler rests inside another executor.
    pub(super) outer: Option<Waker>,
}

/// Tasks that were woken. The one part other threads may touch.
#[derive(Debug, Default)]
pub(super) struct Ready {
    list: Mutex<ReadyList>,
    /// Spares the lock when there is nothing to take.
    pub(super) any: AtomicBool,
}

impl Ready {
    pub(super) fn lock(&self) -> MutexGuard<'_, ReadyList> {
        // Nothing can panic while the lock is held, so a poisoned list is still whole.
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, task: u32) {
        let outer = {
            let mut list = self.lock();
            list.tasks.push(task);
            self.any.store(true, Ordering::Release);
            list.outer.take()
        };
        if let Some(outer) = outer {
            outer.wake();
        }
    }
}

/// Puts its task on the ready list, once until the task is polled.
#[derive(Debug)]
pub(super) struct TaskWaker {
    pub(super) task: u32,
    pub(super) queued: AtomicBool,
    pub(super) ready: Arc<Ready>,
}

impl Wake for TaskWaker {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        if !self.queued.swap(true, Ordering::AcqRel) {
            self.ready.push(self.task);
        }
    }
}
