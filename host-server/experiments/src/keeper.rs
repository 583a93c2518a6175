//! Storing what trials came to, and taking up what ran before.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crawler_records::{EventLevel, Experiment, ExperimentState, RecordsError};
use crawler_sim::evaluate::{Measured, Trial};
use crawler_system::clock::now_ms;
use tokio_util::sync::CancellationToken;

use super::board::Entry;
use super::results::{self, MetricView, Tally};
use super::{Experiments, Recipe};

/// Trials that come within this time are stored together.
const GATHER: Duration = Duration::from_millis(250);
/// How often the records are asked for what should run and does not.
const LOOK: Duration = Duration::from_secs(10);
/// Trials that are read from the records at a time.
const PAGE: u32 = 2_000;

/// Goes on with what ran when the server stopped, and stores what trials come to, until `stop`; then what
/// is done by then.
pub async fn keep(experiments: Arc<Experiments>, stop: CancellationToken) {
    let mut look = tokio::time::interval(LOOK);
    look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = stop.cancelled() => break,
            () = experiments.board.news.notified() => {}
            _ = look.tick() => {
                if let Err(error) = take_up_all(&experiments).await {
                    tracing::warn!(%error, "experiments that ran are not taken up yet");
                }
                continue;
            }
        }
        tokio::select! {
            () = stop.cancelled() => break,
            () = tokio::time::sleep(GATHER) => {}
        }
        if !store_all(&experiments).await {
            // Once more in a while, whether or not more is done by then.
            tokio::select! {
                () = stop.cancelled() => break,
                () = tokio::time::sleep(GATHER * 4) => {}
            }
            experiments.board.news.notify_one();
        }
    }
    store_all(&experiments).await;
}

/// Stores what is done. Returns whether all of it is.
async fn store_all(experiments: &Experiments) -> bool {
    let mut all = true;
    for id in experiments.board.with_news() {
        let mut tallies = experiments.tallies.lock().await;
        let trials = experiments.board.batch(id);
        match store(experiments, &mut tallies, id, trials).await {
            Ok(_) => {}
            Err(RecordsError::NotFound) => {
                // Somebody has changed it past this server.
                tracing::warn!(id, "an experiment does not run any more, by the records");
                experiments.board.leave(id);
                tallies.remove(&id);
            }
            Err(error) => {
                tracing::warn!(%error, id, "trials are not stored yet");
                all = false;
            }
        }
    }
    all
}

/// Stores trials, the next ones of an experiment. Returns how many; the board is told of them.
pub(super) async fn store(
    experiments: &Experiments,
    tallies: &mut HashMap<i64, Tally>,
    id: i64,
    trials: Vec<Trial>,
) -> Result<u32, RecordsError> {
    let count = trials.len() as u32;
    if count == 0 {
        return Ok(0);
    }
    let Some(mut tally) = tallies.remove(&id) else {
        return Ok(0);
    };
    let before = tally.measured.len();
    let successes = trials.iter().filter(|trial| trial.is_success()).count() as u64;
    // Means over a hundred thousand trials take their time.
    let made = tokio::task::spawn_blocking(move || {
        let new = tally.extend(id, &trials, now_ms());
        (tally, new)
    });
    let Ok((mut tally, new)) = made.await else {
        fail(experiments, id, "its results could not be computed").await;
        return Ok(0);
    };
    let complete = new.completed.is_some();
    if let Err(error) = experiments.records.add_trials(new).await {
        tally.measured.truncate(before);
        tallies.insert(id, tally);
        return Err(error);
    }
    experiments.board.advance(id, count);
    let counts = &experiments.counts;
    counts.succeeded.fetch_add(successes, Ordering::Relaxed);
    counts
        .failed
        .fetch_add(u64::from(count) - successes, Ordering::Relaxed);
    if complete {
        experiments.board.leave(id);
        experiments.tell(EventLevel::Info, tally.farewell(ExperimentState::Completed));
        recount(experiments).await;
    } else {
        tallies.insert(id, tally);
    }
    Ok(count)
}

/// Counts anew; where the records are away, the next change does it.
pub(super) async fn recount(experiments: &Experiments) {
    if let Err(error) = experiments.count().await {
        tracing::debug!(%error, "experiments are not counted");
    }
}

/// Notes that an experiment cannot go on.
async fn fail(experiments: &Experiments, id: i64, why: &str) {
    experiments.board.leave(id);
    let (from, to) = (ExperimentState::Running, ExperimentState::Failed);
    let moved = experiments
        .records
        .move_experiment(id, from, to, Some(why), now_ms());
    match moved.await {
        Ok(row) => {
            let text = format!("experiment “{}” has failed: {why}", row.name);
            experiments.tell(EventLevel::Error, text);
        }
        Err(error) => tracing::warn!(%error, id, why, "an experiment cannot go on"),
    }
    recount(experiments).await;
}

/// Takes up what should run here and does not.
async fn take_up_all(experiments: &Experiments) -> Result<(), RecordsError> {
    for row in experiments
        .records
        .experiments_in(ExperimentState::Running)
        .await?
    {
        if !experiments.is_own(&row) || experiments.board.has(row.id) {
            continue;
        }
        let mut tallies = experiments.tallies.lock().await;
        // It may have been paused while others were taken up.
        if let Some(row) = experiments.records.experiment(row.id).await?
            && row.state == ExperimentState::Running
        {
            take_up(experiments, &mut tallies, row).await?;
        }
    }
    experiments.count().await
}

/// Has an experiment run that the records say runs. One that cannot is noted as failed.
///
/// # Errors
/// [`RecordsError`] when its trials cannot be read.
pub(super) async fn take_up(
    experiments: &Experiments,
    tallies: &mut HashMap<i64, Tally>,
    row: Experiment,
) -> Result<(), RecordsError> {
    if experiments.board.has(row.id) {
        return Ok(());
    }
    let (id, known) = (row.id, row.metrics == metrics());
    let recipe = serde_json::from_str::<Recipe>(&row.recipe).map_err(|error| error.to_string());
    let scenario = recipe.and_then(|recipe| Ok((recipe.scenario()?, recipe)));
    let ((scenario, thresholds), recipe) = match scenario {
        Ok(_) if !known => {
            let why = "this version of the program measures other things; make it anew";
            fail(experiments, id, why).await;
            return Ok(());
        }
        Ok(made) => made,
        Err(why) => {
            fail(
                experiments,
                id,
                &format!("this version of the program cannot run it: {why}"),
            )
            .await;
            return Ok(());
        }
    };
    let Some(measured) = stored(experiments, &row).await? else {
        fail(experiments, id, "its trials are not all there").await;
        return Ok(());
    };
    let scenario = Arc::new(scenario);
    let entry = Entry::new(
        id,
        Arc::clone(&scenario),
        recipe.first_seed,
        row.seeds,
        row.done,
    );
    let tally = Tally {
        name: row.name,
        scenario,
        thresholds,
        seeds: row.seeds,
        measured,
    };
    tallies.insert(id, tally);
    experiments.board.enter(entry);
    Ok(())
}

/// What is measured, as it is written.
pub(super) fn metrics() -> String {
    // Names of ours can be written.
    serde_json::to_string(&MetricView::all()).unwrap_or_default()
}

/// What the trials measured that are done; `None` when they are not those that should be there.
async fn stored(
    experiments: &Experiments,
    row: &Experiment,
) -> Result<Option<Vec<Measured>>, RecordsError> {
    let mut measured = Vec::new();
    while (measured.len() as u32) < row.done {
        let next = measured.len() as u32;
        let page = experiments.records.trials(row.id, next, PAGE).await?;
        if page.is_empty() {
            return Ok(None);
        }
        for (number, trial) in (next..row.done).zip(&page) {
            match results::measured(trial).filter(|_| trial.number == number) {
                Some(values) => measured.push(values),
                None => return Ok(None),
            }
        }
    }
    Ok(Some(measured))
}
