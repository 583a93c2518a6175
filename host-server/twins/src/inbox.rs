//! What was heard of robots and waits for their twins. Whoever hears it never waits.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crawler_protocol::{Pose, RobotId};

/// What may wait: more than a second of the largest fleet that has twins.
pub(crate) const MOST_WAITING: usize = 16_384;

/// What was heard.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Evidence {
    /// Of a robot: what its motors were told, and the voltage of its pack, 0 where it has no gauge.
    Sample { duty: [f32; 2], mv: u16 },
    /// Of a tracker.
    Fix(Pose),
}

/// Evidence, of whom, and when it came.
#[derive(Debug, Clone)]
pub(crate) struct Heard {
    pub(crate) robot: RobotId,
    /// Unix milliseconds by the clock of whoever said it.
    pub(crate) timestamp: u64,
    pub(crate) arrived: Instant,
    pub(crate) evidence: Evidence,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(crate) struct Inbox {
    waiting: Mutex<Vec<Heard>>,
    taken: AtomicU64,
}

impl Inbox {
    /// Takes evidence; `false` where there is no room, and it is let go.
    pub(crate) fn put(&self, heard: Heard) -> bool {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let has_room = waiting.len() < MOST_WAITING;
        if has_room {
            waiting.push(heard);
        }
        has_room
    }

    /// Hands over everything that waits, and leaves `empty` in its place, whose room is used again.
    pub(crate) fn swap(&self, empty: &mut Vec<Heard>) {
        empty.clear();
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::swap(&mut *waiting, empty);
        drop(waiting);
        self.taken.fetch_add(empty.len() as u64, Ordering::Relaxed);
    }

    /// How many wait.
    pub(crate) fn len(&self) -> usize {
        let waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.len()
    }

    /// How many were taken out so far.
    pub(crate) fn taken(&self) -> u64 {
        self.taken.load(Ordering::Relaxed)
    }
}
