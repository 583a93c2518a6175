//! A process that works on experiments: it claims parts of those that run, runs their trials and stores what they come
//! to, beside as many others as share the records.
//!
//! It holds what it has claimed by a lease, which it renews. Nobody waits for one that is gone for longer than that, and
//! one that was away for longer finds that others do what it had. What a trial comes to depends on its seed and on the
//! program alone, so a worker takes up only what its own build has begun.

use std::collections::{HashMap, HashSet};
use std::error::Error;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crawler_records::{
    Experiment, ExperimentKind, MAX_WORKER, Records, RecordsError, RunningExperiment, part_size,
};
use crawler_sim::scenario::{Scenario, Threshold};
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use super::board::Board;
use super::recipe::RecipeError;
use super::{Experiments, Recipe, keeper};

/// This program, as far as what a trial comes to depends on it: its version, its robot program, and its simulator.
pub const BUILD: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (",
    env!("EXPERIMENT_BUILD"),
    ")"
);
/// The same for what a training comes to.
pub const TRAINING_BUILD: &str = concat!(
    env!("CARGO_PKG_VERSION"),
    " (",
    env!("EXPERIMENT_BUILD"),
    "-",
    env!("TRAINING_BUILD"),
    ")"
);

/// The program that experiments of a kind need.
pub(super) const fn build_of(kind: ExperimentKind) -> &'static str {
    match kind {
        ExperimentKind::Evaluation => BUILD,
        ExperimentKind::Training => TRAINING_BUILD,
    }
}

/// How long a worker holds what it has claimed without a word.
pub(super) const LEASE: Duration = Duration::from_secs(15);
/// How often it says that it does.
const BEAT: Duration = Duration::from_secs(3);
/// How often the records are asked for what runs.
const LOOK: Duration = Duration::from_secs(1);
/// Trials that come within this time are stored together.
const GATHER: Duration = Duration::from_millis(250);
/// Experiments that run at the same time; others wait for their turn.
const AT_ONCE: usize = 4;
/// For threads to give up their trials.
const PATIENCE: Duration = Duration::from_secs(5);
/// What divides the name of a worker from what tells it from others of that name.
const DIVIDER: char = '#';

/// What this program makes of an experiment.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) name: String,
    pub(super) created: i64,
    pub(super) scenario: Arc<Scenario>,
    pub(super) thresholds: Vec<Threshold>,
    pub(super) first_seed: u64,
    pub(super) seeds: u32,
}

/// Why this program cannot run an experiment.
#[derive(Debug)]
pub(super) enum Unrunnable {
    /// The recipe is of another version.
    Unreadable(serde_json::Error),
    /// It asks for what there is not.
    Recipe(RecipeError),
}

impl fmt::Display for Unrunnable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("this version of the program cannot run it: ")?;
        match self {
            Self::Unreadable(error) => error.fmt(f),
            Self::Recipe(error) => error.fmt(f),
        }
    }
}

impl Error for Unrunnable {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Unreadable(error) => Some(error),
            Self::Recipe(error) => Some(error),
        }
    }
}

/// What this program makes of an experiment, for everybody who asks.
pub(super) type Planned = Result<Arc<Plan>, Arc<Unrunnable>>;

impl Plan {
    fn of(experiment: Experiment) -> Result<Self, Unrunnable> {
        let recipe: Recipe =
            serde_json::from_str(&experiment.recipe).map_err(Unrunnable::Unreadable)?;
        let (scenario, thresholds) = recipe.scenario().map_err(Unrunnable::Recipe)?;
        Ok(Self {
            name: experiment.name,
            created: experiment.created,
            scenario: Arc::new(scenario),
            thresholds,
            first_seed: recipe.first_seed,
            seeds: experiment.seeds,
        })
    }
}

/// What runs, as far as this process knows.
#[derive(Debug, Default)]
struct Known {
    plans: HashMap<i64, (i64, Planned)>,
    /// What this program can work on, in the order in which it was started.
    active: Vec<i64>,
    /// Where there was nothing to claim at the last try.
    exhausted: HashSet<i64>,
    /// Whose turn it is.
    turn: usize,
    /// Experiments of another build that somebody was told of.
    refused: HashSet<i64>,
}

/// A process that works on experiments.
#[derive(Debug)]
pub struct Worker {
    records: Records,
    id: String,
    threads: usize,
    pub(super) board: Arc<Board>,
    known: Mutex<Known>,
    running: Mutex<Vec<JoinHandle<()>>>,
}

/// What is due in the loop of a worker.
#[derive(Debug, Default, Clone, Copy)]
struct Due {
    renew: bool,
    store: bool,
    look: bool,
}

impl Worker {
    /// Nothing runs before [`Worker::begin`]; then so many `threads` run trials. People know it as `name`; `mark` tells
    /// it from others of that name.
    #[must_use]
    pub fn new(records: Records, name: &str, mark: &str, threads: usize) -> Self {
        let mut id = format!("{name}{DIVIDER}{mark}");
        while id.len() > MAX_WORKER {
            id.remove(0);
        }
        Self {
            records,
            id,
            threads,
            board: Arc::default(),
            known: Mutex::default(),
            running: Mutex::default(),
        }
    }

    /// Runs trials until [`Worker::end`], or until this is dropped. What they come to, [`work`] stores.
    ///
    /// # Errors
    /// What the operating system said when it refused threads. There are none then.
    pub fn begin(&self) -> std::io::Result<()> {
        let threads = self.board.start(self.threads)?;
        *self.running.lock().unwrap_or_else(PoisonError::into_inner) = threads;
        Ok(())
    }

    /// Gives up the trials under way and ends the threads.
    pub async fn end(&self) {
        self.board.end();
        let threads =
            std::mem::take(&mut *self.running.lock().unwrap_or_else(PoisonError::into_inner));
        let join = tokio::task::spawn_blocking(move || {
            threads
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

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether an experiment waits until others are done.
    pub(super) fn is_waiting(&self, id: i64) -> bool {
        let known = self.known();
        known
            .active
            .iter()
            .skip(AT_ONCE)
            .any(|active| *active == id)
    }

    /// What this program makes of an experiment that runs; `None` for one that it knows nothing of.
    pub(super) fn plan(&self, id: i64) -> Option<Planned> {
        self.known().plans.get(&id).map(|(_, plan)| plan.clone())
    }

    /// Takes up an experiment that runs by this build, and returns what this program makes of it.
    pub(super) fn take_up(&self, experiment: Experiment) -> Planned {
        let (id, created) = (experiment.id, experiment.created);
        let mut known = self.known();
        let plan = match known.plans.get(&id) {
            Some((of, plan)) if *of == created => plan.clone(),
            _ => Plan::of(experiment).map(Arc::new).map_err(Arc::new),
        };
        known.plans.insert(id, (created, plan.clone()));
        if plan.is_ok() && !known.active.contains(&id) {
            known.active.push(id);
        }
        plan
    }

    /// Has the loop look for something to claim in an experiment.
    pub(super) fn wake(&self, id: i64) {
        self.known().exhausted.remove(&id);
        self.board.demand.notify_one();
    }

    /// Gives up an experiment.
    pub(super) fn leave(&self, id: i64) {
        self.board.leave(id);
        let mut known = self.known();
        known.plans.remove(&id);
        known.active.retain(|active| *active != id);
    }

    /// Takes in what runs.
    async fn learn(&self, running: &[RunningExperiment]) -> Result<(), RecordsError> {
        for row in running.iter().filter(|row| row.build != BUILD) {
            if self.known().refused.insert(row.id) {
                tracing::warn!(
                    id = row.id, build = %row.build, own = BUILD,
                    "refuses an experiment of another build: its numbers would not be the same"
                );
            }
        }
        let own = || running.iter().filter(|row| row.build == BUILD);
        for row in own() {
            let is_known = {
                let known = self.known();
                let plan = known.plans.get(&row.id);
                plan.is_some_and(|(created, _)| *created == row.created)
            };
            if !is_known {
                // Of another experiment that had its number.
                self.leave(row.id);
                self.board.forget(row.id);
                if let Some(experiment) = self.records.experiments().get(row.id).await? {
                    // Who cannot run it leaves it to the server that counts its trials.
                    let _ = self.take_up(experiment);
                }
            }
        }
        let mut known = self.known();
        known
            .plans
            .retain(|id, _| running.iter().any(|row| row.id == *id));
        known
            .refused
            .retain(|id| running.iter().any(|row| row.id == *id));
        let active = own().map(|row| row.id).filter(|id| {
            let plan = known.plans.get(id);
            plan.is_some_and(|(_, plan)| plan.is_ok())
        });
        known.active = active.collect();
        known.exhausted.clear();
        Ok(())
    }

    /// Says that it holds what it holds, and gives up what it does not.
    async fn renew(&self) -> Result<(), RecordsError> {
        let held = self.board.held();
        let parts: Vec<i64> = held.iter().map(|(part, _)| *part).collect();
        let kept = self.records.parts().renew(&self.id, &parts, LEASE).await?;
        if kept.len() == held.len() {
            return Ok(());
        }
        self.board.keep_only(&kept);
        let mut gone: Vec<i64> = held
            .iter()
            .filter(|(part, _)| !kept.contains(part))
            .map(|(_, experiment)| *experiment)
            .collect();
        tracing::info!(
            parts = gone.len(),
            "gives up what does not run any more, or another worker has taken"
        );
        gone.sort_unstable();
        gone.dedup();
        let goes_on = |id: i64| {
            held.iter()
                .any(|(part, of)| *of == id && kept.contains(part))
        };
        for id in gone.into_iter().filter(|id| !goes_on(*id)) {
            self.release(id).await?;
        }
        Ok(())
    }

    /// Stores what is done, and returns of which experiments.
    async fn store(&self) -> Result<Vec<i64>, RecordsError> {
        let with_news = self.board.with_news();
        for &id in &with_news {
            self.store_of(id).await?;
        }
        Ok(with_news)
    }

    /// Stores what is done of an experiment.
    pub(super) async fn store_of(&self, id: i64) -> Result<(), RecordsError> {
        let trials = self.board.batch(id);
        if trials.is_empty() {
            return Ok(());
        }
        let numbers: Vec<u32> = trials.iter().map(|trial| trial.number).collect();
        match self.records.parts().store(&self.id, id, trials).await {
            Ok(_) => self.board.stored(id, &numbers),
            // It was paused or ended, or it is another one by now.
            Err(RecordsError::NotFound | RecordsError::Invalid(_)) => {
                self.leave(id);
                self.board.forget(id);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Claims as much as the threads can do.
    async fn fill(&self) -> Result<(), RecordsError> {
        loop {
            let wanted = self.board.wanted();
            if wanted == 0 {
                return Ok(());
            }
            let Some((id, plan)) = self.next() else {
                return Ok(());
            };
            let size = part_size(plan.seeds) as usize;
            let most = wanted.div_ceil(size).try_into().unwrap_or(u32::MAX);
            let parts = self.records.parts();
            let claimed = parts.claim(&self.id, id, BUILD, most, LEASE).await?;
            if claimed.is_empty() {
                self.known().exhausted.insert(id);
            } else {
                self.board.hold(claimed, &plan.scenario);
            }
        }
    }

    /// The next experiment in which there may be something to claim.
    fn next(&self) -> Option<(i64, Arc<Plan>)> {
        let mut known = self.known();
        let count = known.active.len().min(AT_ONCE);
        for step in 0..count {
            let index = (known.turn + step) % count;
            let id = known.active[index];
            let plan = known.plans.get(&id).and_then(|(_, plan)| plan.clone().ok());
            if let Some(plan) = plan
                && !known.exhausted.contains(&id)
            {
                known.turn = index + 1;
                return Some((id, plan));
            }
        }
        None
    }

    /// Gives back what it holds of an experiment, so that nobody has to wait for the end of the lease.
    pub(super) async fn release(&self, id: i64) -> Result<(), RecordsError> {
        self.records
            .parts()
            .release(&self.id, Some(id), false)
            .await
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.board.end();
    }
}

/// The name of a worker, without what tells it from others of that name.
pub(super) fn shown(id: &str) -> &str {
    id.rsplit_once(DIVIDER).map_or(id, |(name, _)| name)
}

/// The name of this machine, for people.
#[must_use]
pub fn machine() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    let name: String = name.chars().filter(|c| !c.is_control()).take(64).collect();
    if name.is_empty() {
        "worker".to_owned()
    } else {
        name
    }
}

/// Works on experiments until `stop`; then stores what is done by then, and gives back what it holds.
pub async fn work(worker: Arc<Worker>, stop: CancellationToken) {
    run(&worker, None, &stop).await;
}

/// The same, for a server that also counts trials.
pub(super) async fn run(worker: &Worker, server: Option<&Experiments>, stop: &CancellationToken) {
    let (mut look, mut beat) = (tokio::time::interval(LOOK), tokio::time::interval(BEAT));
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // A server that was killed comes back under its name, and what it held is nobody's.
    let mut fresh = server.is_some();
    let mut away = false;
    loop {
        let mut due = Due::default();
        tokio::select! {
            () = stop.cancelled() => break,
            () = worker.board.news.notified() => {
                due.store = true;
                tokio::select! {
                    () = stop.cancelled() => break,
                    () = tokio::time::sleep(GATHER) => {}
                }
            }
            () = worker.board.demand.notified() => {}
            _ = look.tick() => (due.look, due.store) = (true, true),
            _ = beat.tick() => due.renew = true,
        }
        let outcome = step(worker, server, due, &mut fresh).await;
        match outcome {
            Ok(()) if away => tracing::info!("experiments go on: the records are there again"),
            Err(ref error) if !away => tracing::warn!(%error, "experiments wait for the records"),
            _ => {}
        }
        away = outcome.is_err();
    }
    // Threads have been told, or will be: nothing that is done later is stored.
    worker.board.end();
    let due = Due {
        store: true,
        ..Due::default()
    };
    if let Err(error) = step(worker, server, due, &mut false).await {
        tracing::warn!(%error, "what is done of experiments is not stored, and done again later");
    }
    if let Err(error) = worker
        .records
        .parts()
        .release(&worker.id, None, false)
        .await
    {
        tracing::warn!(%error, "what is held of experiments is free when its lease ends");
    }
}

/// Does what is due, alone with the experiments of this server.
async fn step(
    worker: &Worker,
    server: Option<&Experiments>,
    due: Due,
    fresh: &mut bool,
) -> Result<(), RecordsError> {
    let mut tallies = match server {
        Some(server) => Some((server, server.tallies.lock().await)),
        None => None,
    };
    if *fresh {
        worker
            .records
            .parts()
            .release(&worker.id, None, true)
            .await?;
        *fresh = false;
    }
    if due.renew {
        worker.renew().await?;
    }
    if due.store {
        let stored = worker.store().await?;
        if let Some((server, tallies)) = &mut tallies {
            for id in stored {
                keeper::count_own(server, tallies, id).await?;
            }
        }
    }
    if due.look {
        let running = worker.records.parts().running().await?;
        worker.learn(&running).await?;
        if let Some((server, tallies)) = &mut tallies {
            keeper::see(server, tallies, &running).await?;
        }
    }
    worker.fill().await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_worker_is_shown_by_its_name() {
        let records = Records::in_memory().await.expect("records");
        let worker = |name: &str| Worker::new(records.clone(), name, "0123abcd", 1);
        assert_eq!(shown(&worker("lab-1").id), "lab-1");
        assert_eq!(shown(&worker("lab#1").id), "lab#1");
        let long = worker(&"\u{e4}".repeat(64));
        assert!(long.id.len() <= MAX_WORKER && long.id.ends_with("#0123abcd"));
        assert!(!machine().is_empty());
        assert!(BUILD.len() <= 96, "{BUILD}");
        assert!(TRAINING_BUILD.len() <= 96, "{TRAINING_BUILD}");
    }
}
