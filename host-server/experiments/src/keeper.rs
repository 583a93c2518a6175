//! Counting what trials came to, in the order of their seeds, and taking up what ran before.
//!
//! Workers store trials in any order. One server counts those of an experiment: the one that was asked for it, or another
//! one that has seen for a while that nobody does. That two of them count is no harm: what is written fits on what is
//! there, or is refused.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crawler_records::{
    EventLevel, ExperimentState, Holder, RecordsError, RunningExperiment, StoredTrial,
};
use crawler_sim::evaluate::Measured;
use crawler_system::clock::now_ms;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::results::{self, MetricView, Tally};
use super::worker::{self, BUILD, LEASE, Plan};
use super::{AtWork, Experiments};

/// Trials that are read from the records at a time.
const PAGE: u32 = 2_000;

/// Goes on with what ran when the server stopped, works on what runs, and counts what trials come to, until `stop`; then
/// stores what is done by then.
pub async fn keep(experiments: Arc<Experiments>, stop: CancellationToken) {
    worker::run(&experiments.worker, Some(&experiments), &stop).await;
}

/// What was seen of an experiment that another server counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Watched {
    done: u32,
    since: Instant,
}

/// Takes in what runs: what this server counts goes on, and what nobody counts it takes over.
pub(super) async fn see(
    experiments: &Experiments,
    tallies: &mut HashMap<i64, Tally>,
    running: &[RunningExperiment],
) -> Result<(), RecordsError> {
    let mut watched = HashMap::new();
    for row in running {
        let own = experiments.is_own(&row.owner);
        if row.build != BUILD {
            // Who has the records in a file is alone with them.
            if experiments.records.database().is_none() {
                let why = format!(
                    "another build of the program has begun it ({}): this one ({BUILD}) may come to other numbers; \
                     make it anew",
                    or_unknown(&row.build)
                );
                fail(experiments, row.id, &why).await;
            }
            continue;
        }
        let plan = match experiments.worker.plan(row.id) {
            Some(Ok(plan)) => plan,
            Some(Err(why)) if own => {
                fail(experiments, row.id, &why.to_string()).await;
                continue;
            }
            _ => continue,
        };
        if let Some(number) = row.stuck.filter(|_| own) {
            let seed = plan.first_seed.wrapping_add(number.into());
            let why =
                format!("too many workers did not come back from its trials from seed {seed} on");
            fail(experiments, row.id, &why).await;
            continue;
        }
        if row.ready {
            if !own {
                let seen = experiments.watched().get(&row.id).copied();
                let seen = seen.filter(|seen| seen.done == row.done);
                let seen = seen.unwrap_or_else(|| Watched {
                    done: row.done,
                    since: Instant::now(),
                });
                watched.insert(row.id, seen);
                if seen.since.elapsed() < LEASE {
                    continue;
                }
                let parts = experiments.records.parts();
                if !parts
                    .hand_over(row.id, &row.owner, &experiments.owner)
                    .await?
                {
                    continue;
                }
                tracing::warn!(id = row.id, from = %row.owner, "counts the trials of an experiment that its server does not");
            }
            count(experiments, tallies, row.id).await?;
        } else if !row.divided && row.done < row.seeds {
            divide(experiments, row.id, &plan).await?;
        }
    }
    *experiments.watched() = watched;
    let is_running = |id: &i64| running.iter().any(|row| row.id == *id);
    tallies.retain(|id, _| is_running(id));
    note_workers(experiments, experiments.records.parts().holders().await?);
    experiments.count().await
}

/// Notes who works on what.
fn note_workers(experiments: &Experiments, holders: Vec<Holder>) {
    let mut at_work: HashMap<i64, Vec<AtWork>> = HashMap::new();
    for holder in holders {
        let workers = at_work.entry(holder.experiment).or_default();
        workers.push(AtWork {
            name: worker::shown(&holder.worker).to_owned(),
            seeds: holder.seeds,
        });
    }
    *experiments.at_work() = at_work;
}

/// Divides what is left of an experiment among whoever works.
pub(super) async fn divide(
    experiments: &Experiments,
    id: i64,
    plan: &Plan,
) -> Result<(), RecordsError> {
    let parts = experiments.records.parts();
    match parts.divide(id, plan.first_seed).await {
        // It does not run any more.
        Ok(()) | Err(RecordsError::NotFound) => {
            experiments.worker.wake(id);
            Ok(())
        }
        Err(error) => Err(error),
    }
}

/// Counts the trials of an experiment, if this server does that.
pub(super) async fn count_own(
    experiments: &Experiments,
    tallies: &mut HashMap<i64, Tally>,
    id: i64,
) -> Result<(), RecordsError> {
    match experiments.records.experiments().get(id).await? {
        Some(row) if experiments.is_own(&row.owner) => count(experiments, tallies, id).await,
        _ => Ok(()),
    }
}

/// Counts the trials of an experiment that are stored without a gap.
///
/// # Errors
/// [`RecordsError`] when they cannot be read or written.
pub(super) async fn count(
    experiments: &Experiments,
    tallies: &mut HashMap<i64, Tally>,
    id: i64,
) -> Result<(), RecordsError> {
    loop {
        let row = experiments.records.experiments().get(id).await?;
        let Some(row) = row.filter(|row| row.state == ExperimentState::Running) else {
            tallies.remove(&id);
            return Ok(());
        };
        let Some(Ok(plan)) = experiments.worker.plan(id) else {
            return Ok(());
        };
        let tally = tallies.remove(&id);
        let fits = |tally: &Tally| {
            tally.created == row.created && tally.measured.len() <= row.done as usize
        };
        let mut tally = tally.filter(fits).unwrap_or_else(|| Tally::new(&plan));
        // What others have counted.
        while (tally.measured.len() as u32) < row.done {
            let from = tally.measured.len() as u32;
            let limit = PAGE.min(row.done - from);
            let (trials, measured) = next(experiments, id, from, limit).await?;
            if trials.is_empty() {
                fail(experiments, id, "its trials are not all there").await;
                return Ok(());
            }
            tally.measured.extend(measured);
        }
        let limit = PAGE.min(row.seeds.saturating_sub(row.done));
        let (trials, measured) = next(experiments, id, row.done, limit).await?;
        if trials.is_empty() {
            tallies.insert(id, tally);
            return Ok(());
        }
        let full = trials.len() == PAGE as usize;
        let successes = trials.iter().filter(|trial| trial.success).count() as u64;
        let failures = trials.len() as u64 - successes;
        // Means over a hundred thousand trials take their time.
        let made = tokio::task::spawn_blocking(move || {
            let new = tally.extend(id, trials, measured, now_ms());
            (tally, new)
        });
        let Ok((tally, new)) = made.await else {
            fail(experiments, id, "its results could not be computed").await;
            return Ok(());
        };
        let complete = new.completed.is_some();
        match experiments.records.trials().add(new).await {
            Ok(()) => {}
            // Another server has counted them, or somebody has paused it: what is so is read anew.
            Err(RecordsError::NotFound) => continue,
            Err(error) => return Err(error),
        }
        let counts = &experiments.counts;
        counts.succeeded.fetch_add(successes, Ordering::Relaxed);
        counts.failed.fetch_add(failures, Ordering::Relaxed);
        if complete {
            experiments.worker.leave(id);
            experiments.tell(EventLevel::Info, tally.farewell(ExperimentState::Completed));
            recount(experiments).await;
            return Ok(());
        }
        tallies.insert(id, tally);
        if !full {
            return Ok(());
        }
    }
}

/// The stored trials of an experiment from number `from` to the first gap, and what they measured.
async fn next(
    experiments: &Experiments,
    id: i64,
    from: u32,
    limit: u32,
) -> Result<(Vec<StoredTrial>, Vec<Measured>), RecordsError> {
    let mut trials = experiments.records.trials().page(id, from, limit).await?;
    let mut measured = Vec::with_capacity(trials.len());
    for (number, trial) in (from..).zip(&trials) {
        match results::measured(trial).filter(|_| trial.number == number) {
            Some(values) => measured.push(values),
            None => break,
        }
    }
    trials.truncate(measured.len());
    Ok((trials, measured))
}

/// Counts anew; where the records are away, the next change does it.
pub(super) async fn recount(experiments: &Experiments) {
    if let Err(error) = experiments.count().await {
        tracing::debug!(%error, "experiments are not counted");
    }
}

/// Notes that an experiment cannot go on.
pub(super) async fn fail(experiments: &Experiments, id: i64, why: &str) {
    experiments.worker.leave(id);
    let (from, to) = (ExperimentState::Running, ExperimentState::Failed);
    let moved = experiments
        .records
        .experiments()
        .change_state(id, from, to, Some(why), now_ms());
    match moved.await {
        Ok(row) => {
            let text = format!("experiment “{}” has failed: {why}", row.name);
            experiments.tell(EventLevel::Error, text);
        }
        Err(error) => tracing::warn!(%error, id, why, "an experiment cannot go on"),
    }
    recount(experiments).await;
}

/// A build, for people.
pub(super) fn or_unknown(build: &str) -> &str {
    if build.is_empty() {
        "of an earlier version"
    } else {
        build
    }
}

/// What is measured, as it is written.
pub(super) fn metrics() -> String {
    // Names of ours can be written.
    serde_json::to_string(&MetricView::all()).unwrap_or_default()
}
