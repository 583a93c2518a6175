//! Experiments: evaluations of a scenario on many seeds, by threads of this process beside its other
//! work, kept in the records.
//!
//! What the records say is so. The board has what runs, tallies what its trials came to so far; one lock
//! makes control and storing wait for each other. A trial is the same whenever it runs, so one that is given
//! up costs time and nothing else.
//!
//! - [`scenarios`]: scenarios from names and files, with changes.
//! - [`evaluate`]: the same on the command line, with sweeps, drawn parameters and the search for a run that
//!   breaks something. It runs and judges trials by the same means (`crawler_sim::evaluate`), so both come to
//!   the same numbers.
//! - `recipe` reads what an experiment is asked to be, `control` makes, starts, pauses and ends it, `board`
//!   runs its trials, `keeper` stores them and takes up what ran before, `results` has what they come to.

pub mod evaluate;
pub mod scenarios;

mod board;
mod control;
mod keeper;
mod recipe;
mod results;

use std::collections::HashMap;
use std::num::NonZeroU8;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crawler_records::{EventLevel, Experiment, ExperimentState, Records, RecordsError};
use tokio::sync::Semaphore;
use tokio_util::task::TaskTracker;

use crawler_metrics::Exposition;
use crawler_system::data::{DataDir, DataError};

use board::Board;
pub use control::{Action, ControlError, act, create, delete};
pub use keeper::keep;
pub use recipe::{FieldError, MAX_SEED, Recipe};
use results::Tally;
pub use results::{Judged, MetricView, Results, Summary};

/// File with the number by which this server knows its experiments, in the data directory.
const OWNER: &str = "experiments-owner";
/// Recipes that are tried out at a time.
const BUILDING: usize = 2;
/// For threads to give up their trials.
const PATIENCE: Duration = Duration::from_secs(5);

/// Tells those who watch the fleet what becomes of experiments.
pub type Tell = Box<dyn Fn(EventLevel, String) + Send + Sync>;

/// The experiments of this server.
pub struct Experiments {
    records: Records,
    tell: Tell,
    /// What was begun for somebody and goes on without them.
    tasks: TaskTracker,
    board: Arc<Board>,
    /// What runs came to so far. Whoever holds it is alone with all experiments of this server.
    tallies: tokio::sync::Mutex<HashMap<i64, Tally>>,
    /// How this server is called in records that it shares with others.
    owner: String,
    threads: usize,
    workers: Mutex<Vec<JoinHandle<()>>>,
    building: Arc<Semaphore>,
    counts: Counts,
}

/// Counted for the metrics.
#[derive(Debug, Default)]
struct Counts {
    states: [AtomicU64; ExperimentState::ALL.len()],
    succeeded: AtomicU64,
    failed: AtomicU64,
}

/// Numbers for the metrics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ExperimentNumbers {
    /// Experiments of this server, in the order of [`ExperimentState::ALL`].
    pub states: [u64; ExperimentState::ALL.len()],
    /// Trials stored since the start that were a success.
    pub succeeded: u64,
    /// And that were none.
    pub failed: u64,
}

impl ExperimentNumbers {
    /// Every state has a line, also one that no experiment is in.
    pub fn write_metrics(self, out: &mut Exposition) {
        let states = ExperimentState::ALL.map(ExperimentState::name);
        let counts = self.states.map(|count| count as usize);
        out.gauges(
            "terracrawler_experiments",
            "Experiments of this server, by state",
            "state",
            states.into_iter().zip(counts),
        );
        out.counters(
            "terracrawler_experiment_trials",
            "Trials of experiments that were stored, by what they came to",
            "outcome",
            [("success", self.succeeded), ("failure", self.failed)],
        );
    }
}

/// The name of this server in the records: the one that it has, or a new one.
///
/// # Errors
/// [`DataError`] when it cannot be read or kept.
pub fn owner(data: &DataDir) -> Result<String, DataError> {
    if let Some(number) = data.number(OWNER)? {
        return Ok(format!("{number:016x}"));
    }
    let mut bytes = [0; 8];
    let drawn = getrandom::fill(&mut bytes);
    drawn.map_err(|error| data.failed(OWNER, std::io::Error::other(error)))?;
    let number = u64::from_ne_bytes(bytes);
    data.set_number(OWNER, number)?;
    Ok(format!("{number:016x}"))
}

impl Experiments {
    /// Nothing runs before [`Experiments::begin`]; then so many `threads` run trials, half as many as there are
    /// processors when nobody says. `owner` is how this server is called in `records`, and `tasks` is what it
    /// waits for before it ends.
    #[must_use]
    pub fn new(
        records: Records,
        owner: String,
        threads: Option<NonZeroU8>,
        tasks: TaskTracker,
        tell: Tell,
    ) -> Self {
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        let threads = threads.map(|threads| usize::from(threads.get()));
        Self {
            records,
            tell,
            tasks,
            board: Arc::default(),
            tallies: tokio::sync::Mutex::default(),
            owner,
            // Half of the machine is for whoever watches and steers.
            threads: threads.unwrap_or_else(|| (cores() / 2).max(1)),
            workers: Mutex::default(),
            building: Arc::new(Semaphore::new(BUILDING)),
            counts: Counts::default(),
        }
    }

    /// Runs trials until [`Experiments::end`], or until this is dropped. What they come to, [`keep`] stores.
    ///
    /// # Errors
    /// What the operating system said when it refused threads. There are none then.
    pub fn begin(&self) -> std::io::Result<()> {
        let workers = self.board.start(self.threads)?;
        *self.workers.lock().unwrap_or_else(PoisonError::into_inner) = workers;
        Ok(())
    }

    /// Gives up the trials under way and ends the threads. What runs goes on at the next start.
    pub async fn end(&self) {
        self.board.end();
        let workers =
            std::mem::take(&mut *self.workers.lock().unwrap_or_else(PoisonError::into_inner));
        let join = tokio::task::spawn_blocking(move || {
            workers
                .into_iter()
                .map(JoinHandle::join)
                .filter(Result::is_err)
                .count()
        });
        match tokio::time::timeout(PATIENCE, join).await {
            Ok(Ok(0)) => {}
            Ok(_) => tracing::error!("a thread of experiments ended badly"),
            Err(_) => tracing::warn!("a trial does not stop and is left behind"),
        }
    }

    /// Whether this server runs that experiment. Records in a file are its own, whoever wrote them.
    fn is_own(&self, experiment: &Experiment) -> bool {
        self.records.database().is_none() || experiment.owner == self.owner
    }

    /// Whether an experiment waits until others are done.
    #[must_use]
    pub fn is_waiting(&self, id: i64) -> bool {
        self.board.is_waiting(id)
    }

    /// Numbers for the metrics.
    pub fn numbers(&self) -> ExperimentNumbers {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        ExperimentNumbers {
            states: self.counts.states.each_ref().map(load),
            succeeded: load(&self.counts.succeeded),
            failed: load(&self.counts.failed),
        }
    }

    /// Counts anew, after a change.
    async fn count(&self) -> Result<(), RecordsError> {
        let everybodys = self.records.database().is_none();
        let mut states = [0; ExperimentState::ALL.len()];
        for (owner, state, count) in self.records.experiments_by_state().await? {
            if everybodys || owner == self.owner {
                states[state as usize] += count;
            }
        }
        for (kept, count) in self.counts.states.iter().zip(states) {
            kept.store(count, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Tells those who watch the fleet.
    fn tell(&self, level: EventLevel, text: String) {
        tracing::info!("{text}");
        (self.tell)(level, text);
    }
}

impl Drop for Experiments {
    fn drop(&mut self) {
        self.board.end();
    }
}
