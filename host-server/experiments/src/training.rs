//! Experiments that learn: a policy is trained by one server, in a thread that gives way to all others.
//!
//! What the records say is so: which trainings run, and how many rounds of each are kept. What a training learned is in
//! a folder of its own in the data directory, by the same means as `terracrawler train`, and comes to the same bytes:
//! whoever is killed goes on from the last checkpoint. One training runs at a time, and others wait.
//!
//! Reading order: `asked`, what a training is to be; `told`, what is said of it; `learning`, by itself or by nodes at the broker; `job`, the
//! thread that learns; `keeper`, which has it run, stand and end as the records say.

mod asked;
mod job;
mod keeper;
mod learning;
mod told;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crawler_federation::Broker;
use crawler_records::Experiment;
use tokio::sync::Notify;

pub(super) use asked::read;
pub use asked::{Asked, AskedNodes};
pub use keeper::train;
pub use told::{CurvePoint, NodeView, NodesView, Outcome, Score, TrainingFile};

use job::Job;

/// Trains what runs, one after the other.
#[derive(Debug)]
pub(super) struct Trainer {
    /// A folder for each training is in here.
    folder: PathBuf,
    threads: NonZeroUsize,
    /// Where nodes are met.
    broker: Option<Broker>,
    /// Something may have changed in the records.
    changed: Notify,
    /// What is being trained.
    now: Mutex<Option<Arc<Job>>>,
}

impl Trainer {
    pub(super) fn new(folder: PathBuf, threads: NonZeroUsize, broker: Option<Broker>) -> Self {
        Self {
            folder,
            threads,
            broker,
            changed: Notify::new(),
            now: Mutex::default(),
        }
    }

    /// Has the records looked at at once.
    pub(super) fn wake(&self) {
        self.changed.notify_one();
    }

    /// Whether this one is being trained.
    pub(super) fn is_at(&self, training: &Experiment) -> bool {
        self.job(training).is_some()
    }

    fn now(&self) -> MutexGuard<'_, Option<Arc<Job>>> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is being trained, if it is this one.
    fn job(&self, training: &Experiment) -> Option<Arc<Job>> {
        self.now()
            .as_ref()
            .filter(|job| job.is_of(training))
            .cloned()
    }

    /// The folder of a training. After a backup was put back, another one may have its number.
    fn folder_of(&self, training: &Experiment) -> PathBuf {
        folder_in(&self.folder, training.id, training.created)
    }
}

fn folder_in(folder: &Path, id: i64, created: i64) -> PathBuf {
    folder.join(format!("{id}-{created}"))
}
