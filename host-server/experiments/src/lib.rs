//! Experiments: evaluations of a scenario on many seeds, by threads of this process beside its other
//! work, and by as many other processes as share the records; and trainings of policies, by one server each.
//!
//! What the records say is so. They have what is left to do, part by part; a worker claims a part, runs its trials and
//! stores what they come to. One server counts them in the order of their seeds. A trial is the same whenever and
//! wherever it runs, so one that is given up costs time and nothing else.
//!
//! - [`scenarios`]: scenarios from names and files, with changes.
//! - [`evaluate`]: the same on the command line, with sweeps, drawn parameters and the search for a run that
//!   breaks something. It runs and judges trials by the same means (`crawler_sim::evaluate`), so both come to
//!   the same numbers.
//! - [`sequential`]: whether one of two is better, asked after each pair of runs.
//! - `recipe` reads what an experiment is asked to be, `control` makes, starts, pauses and ends it, `worker` claims its
//!   parts and stores what comes of them, `board` has those of this process and runs their trials, `keeper` counts
//!   trials, `results` has what they come to.
//! - `training` has the experiments that learn: what they are asked to be, the thread in which they do, their files.

pub mod evaluate;
pub mod scenarios;
pub mod sequential;

mod board;
mod control;
mod keeper;
mod recipe;
mod results;
mod training;
mod worker;

use std::collections::HashMap;
use std::num::{NonZeroU8, NonZeroUsize};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crawler_federation::Broker;
use crawler_records::{
    EventLevel, Experiment, ExperimentKind, ExperimentState, Records, RecordsError,
};
use serde::Serialize;
use tokio::sync::Semaphore;
use tokio_util::task::TaskTracker;

use crawler_metrics::Exposition;
use crawler_system::data::{DataDir, DataError};
use utoipa::ToSchema;

pub use control::{Action, ControlError, act, create, delete};
pub use keeper::keep;
pub use recipe::{FieldError, MAX_SEED, Recipe};
use results::Tally;
pub use results::{Judged, MetricView, Results, Summary};
use training::Trainer;
pub use training::{
    Asked as TrainingAsked, AskedNodes, CurvePoint, NodeView, NodesView,
    Outcome as TrainingOutcome, Score as TrainingScore, TrainingFile, train,
};
pub use worker::{BUILD, TRAINING_BUILD, Worker, machine, work};

use keeper::{Watched, or_unknown};

/// File with the number by which this server knows its experiments, in the data directory.
const OWNER: &str = "experiments-owner";
/// Recipes that are tried out at a time.
const BUILDING: usize = 2;

/// Tells those who watch the fleet what becomes of experiments.
pub type Tell = Box<dyn Fn(EventLevel, String) + Send + Sync>;

/// The experiments of this server.
pub struct Experiments {
    records: Records,
    tell: Tell,
    /// What was begun for somebody and goes on without them.
    tasks: TaskTracker,
    worker: Worker,
    trainer: Trainer,
    /// What runs came to so far. Whoever holds it is alone with all experiments of this server.
    tallies: tokio::sync::Mutex<HashMap<i64, Tally>>,
    /// How this server is called in records that it shares with others.
    owner: String,
    /// Experiments that others count, and do not.
    watched: Mutex<HashMap<i64, Watched>>,
    /// Who works on what.
    at_work: Mutex<HashMap<i64, Vec<AtWork>>>,
    building: Arc<Semaphore>,
    counts: Counts,
}

/// A process that works on an experiment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = ExperimentWorker)]
pub struct AtWork {
    /// Its name: that of its machine, unless it was given another one.
    pub name: String,
    /// How many seeds it is at.
    pub seeds: u64,
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
    /// Claims of processes on parts of experiments: one for each process and experiment.
    pub workers: u64,
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
        out.gauge(
            "terracrawler_experiment_workers",
            "Processes that work on experiments, by what the records say",
            self.workers as f64,
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
    let number = drawn().map_err(|error| data.failed(OWNER, std::io::Error::other(error)))?;
    data.set_number(OWNER, number)?;
    Ok(format!("{number:016x}"))
}

/// What tells a worker from others of its name; `None` where the system has no randomness.
#[must_use]
pub fn mark() -> Option<String> {
    drawn().ok().map(|number| format!("{number:016x}"))
}

fn drawn() -> Result<u64, getrandom::Error> {
    let mut bytes = [0; 8];
    getrandom::fill(&mut bytes)?;
    Ok(u64::from_ne_bytes(bytes))
}

impl Experiments {
    /// Nothing runs before [`Experiments::begin`]; then so many `threads` run trials, half as many as there are
    /// processors when nobody says. `owner` is how this server is called in `records`, `name` how people know it among
    /// those who work on experiments, and `tasks` is what it waits for before it ends. `folder` is for the files of
    /// trainings, whose nodes are met at the `broker`.
    #[must_use]
    // Each is another thing.
    #[expect(clippy::too_many_arguments)]
    pub fn new(
        records: Records,
        folder: PathBuf,
        owner: String,
        name: &str,
        threads: Option<NonZeroU8>,
        tasks: TaskTracker,
        broker: Option<Broker>,
        tell: Tell,
    ) -> Self {
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        let threads = threads.map(|threads| usize::from(threads.get()));
        // Half of the machine is for whoever watches and steers.
        let threads = threads.unwrap_or_else(|| (cores() / 2).max(1));
        Self {
            worker: Worker::new(records.clone(), name, &owner, threads),
            trainer: Trainer::new(
                folder,
                NonZeroUsize::new(threads).unwrap_or(NonZeroUsize::MIN),
                broker,
            ),
            records,
            tell,
            tasks,
            tallies: tokio::sync::Mutex::default(),
            owner,
            watched: Mutex::default(),
            at_work: Mutex::default(),
            building: Arc::new(Semaphore::new(BUILDING)),
            counts: Counts::default(),
        }
    }

    /// Runs trials until [`Experiments::end`], or until this is dropped. What they come to, [`keep`] stores.
    ///
    /// # Errors
    /// What the operating system said when it refused threads. There are none then.
    pub fn begin(&self) -> std::io::Result<()> {
        self.worker.begin()
    }

    /// Gives up the trials under way and ends the threads. What runs goes on at the next start, or on another server.
    pub async fn end(&self) {
        self.worker.end().await;
    }

    /// Whether this server counts the trials of an experiment of that owner. Records in a file are its own, whoever
    /// wrote them.
    fn is_own(&self, owner: &str) -> bool {
        self.records.database().is_none() || owner == self.owner
    }

    /// Whether an experiment that runs waits until others are done, or for somebody who can work on it.
    #[must_use]
    pub fn is_waiting(&self, experiment: &Experiment) -> bool {
        let is_behind = match experiment.kind {
            ExperimentKind::Evaluation => self.worker.is_waiting(experiment.id),
            ExperimentKind::Training => {
                experiment.state == ExperimentState::Running && !self.trainer.is_at(experiment)
            }
        };
        is_behind || self.waits_for(experiment).is_some()
    }

    /// For whom an experiment waits that runs, where this server cannot work on it; for people.
    #[must_use]
    pub fn waits_for(&self, experiment: &Experiment) -> Option<String> {
        if experiment.state != ExperimentState::Running {
            return None;
        }
        let own = worker::build_of(experiment.kind);
        if experiment.build != own {
            let build = or_unknown(&experiment.build);
            return Some(format!(
                "waits for a server or worker of its build, {build}: this server is {own}"
            ));
        }
        let elsewhere =
            experiment.kind == ExperimentKind::Training && !self.is_own(&experiment.owner);
        elsewhere.then(|| {
            "goes on where it was begun: at another server, which has its files".to_owned()
        })
    }

    /// Who works on an experiment, by name, as of a second or so ago.
    #[must_use]
    pub fn workers(&self, experiment: i64) -> Vec<AtWork> {
        self.at_work().get(&experiment).cloned().unwrap_or_default()
    }

    fn at_work(&self) -> MutexGuard<'_, HashMap<i64, Vec<AtWork>>> {
        self.at_work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn watched(&self) -> MutexGuard<'_, HashMap<i64, Watched>> {
        self.watched.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Numbers for the metrics.
    pub fn numbers(&self) -> ExperimentNumbers {
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        ExperimentNumbers {
            states: self.counts.states.each_ref().map(load),
            succeeded: load(&self.counts.succeeded),
            failed: load(&self.counts.failed),
            workers: self.at_work().values().map(|at| at.len() as u64).sum(),
        }
    }

    /// Counts anew, after a change.
    async fn count(&self) -> Result<(), RecordsError> {
        let mut states = [0; ExperimentState::ALL.len()];
        for (owner, state, count) in self.records.experiments().by_state().await? {
            if self.is_own(&owner) {
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
