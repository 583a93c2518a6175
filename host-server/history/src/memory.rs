//! What is not in a block yet, where writer and readers meet.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crawler_database::RecordsError;
use crawler_protocol::RobotId;
use tokio::sync::{Notify, oneshot};

use super::Sample;
use super::Stats;
use super::fold::{Bucket, Raw};

/// Samples by number of their robot.
pub(super) type Lots = HashMap<i64, Vec<Raw>>;
/// Tells who waits for the disk what came of it.
pub(super) type Waiting = oneshot::Sender<Result<(), RecordsError>>;

/// What came in and was not looked at.
#[derive(Debug, Default)]
pub(super) struct Inbox {
    /// Whether somebody looks.
    pub(super) open: bool,
    pub(super) samples: Vec<Sample>,
    pub(super) waiting: Vec<Waiting>,
    /// Those who wait for blocks, too.
    pub(super) settling: Vec<Waiting>,
}

/// The last block of minutes of a robot, which is written anew until it is an hour long: a block per
/// minute would be all overhead.
#[derive(Debug)]
pub(super) struct Minutes {
    pub(super) block: i64,
    pub(super) rows: Vec<Bucket>,
}

/// What is on disk in the tail alone, and how to tell blocks that have it too.
#[derive(Debug, Default)]
pub(super) struct Memory {
    /// Whether this process writes; otherwise the rest is empty.
    pub(super) keeper: bool,
    pub(super) numbers: HashMap<RobotId, i64>,
    pub(super) next_robot: i64,
    pub(super) open: Lots,
    pub(super) open_count: usize,
    /// What is being made into blocks. Still read from here until they are on disk.
    pub(super) sealing: Option<Arc<Lots>>,
    pub(super) minutes: HashMap<i64, Arc<Minutes>>,
    /// Blocks from this number on have samples that are in `open` or `sealing`.
    pub(super) next_block: i64,
}

/// What a reader needs of [`Memory`], all of one moment.
#[derive(Debug, Default)]
pub(super) struct View {
    /// Whether `number` is the answer, or must be looked up.
    pub(super) keeper: bool,
    pub(super) number: Option<i64>,
    /// Blocks from this number on are not to be read.
    pub(super) below: i64,
    pub(super) rows: Vec<Raw>,
    pub(super) minutes: Option<Arc<Minutes>>,
}

impl Memory {
    pub(super) fn view(&self, robot: &RobotId, from: i64, to: i64) -> View {
        let number = self.numbers.get(robot).copied();
        let mut rows = Vec::new();
        if let Some(number) = number {
            let sealing = self.sealing.as_ref().and_then(|lots| lots.get(&number));
            for lot in sealing.into_iter().chain(self.open.get(&number)) {
                rows.extend(lot.iter().filter(|row| (from..to).contains(&row[0])));
            }
        }
        View {
            keeper: self.keeper,
            number,
            below: if self.keeper {
                self.next_block
            } else {
                i64::MAX
            },
            rows,
            minutes: number.and_then(|number| self.minutes.get(&number).cloned()),
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct Counts {
    pub(super) accepted: AtomicU64,
    pub(super) dropped: AtomicU64,
    pub(super) beyond: AtomicU64,
    pub(super) written: AtomicU64,
    pub(super) blocks: AtomicU64,
    pub(super) expired: AtomicU64,
    pub(super) failures: AtomicU64,
    pub(super) damaged: AtomicU64,
}

#[derive(Debug, Default)]
pub(crate) struct Shared {
    inbox: Mutex<Inbox>,
    memory: Mutex<Memory>,
    pub(super) wake: Notify,
    pub(super) counts: Counts,
    pub(super) set_aside: Option<PathBuf>,
}

impl Shared {
    pub(super) fn new(memory: Memory, set_aside: Option<PathBuf>) -> Self {
        Self {
            inbox: Mutex::new(Inbox {
                open: memory.keeper,
                ..Inbox::default()
            }),
            memory: Mutex::new(memory),
            set_aside,
            ..Self::default()
        }
    }

    /// A panic of somebody else leaves nothing half done in here: the lock is taken all the same.
    pub(super) fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn stats(&self) -> Stats {
        let queued = self.inbox().samples.len() as u64;
        let (open, keeper) = {
            let memory = self.memory();
            let sealing = memory
                .sealing
                .as_ref()
                .map_or(0, |lots| lots.values().map(Vec::len).sum());
            (memory.open_count + sealing, memory.keeper)
        };
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Stats {
            accepted: count(&self.counts.accepted),
            dropped: count(&self.counts.dropped),
            beyond: count(&self.counts.beyond),
            written: count(&self.counts.written),
            queued,
            open: open as u64,
            blocks: count(&self.counts.blocks),
            expired: count(&self.counts.expired),
            failures: count(&self.counts.failures),
            damaged: count(&self.counts.damaged),
            keeper,
            set_aside: self.set_aside.clone(),
        }
    }
}
