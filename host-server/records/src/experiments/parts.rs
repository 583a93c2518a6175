//! What is left to do of experiments, part by part, and who does it.
//!
//! Workers are the servers that share the records, and processes that do nothing else. Each claims parts, and holds
//! them for as long as it renews its hold; the clock is that of the database, so nobody's own matters. What a worker
//! that is gone was at, another one claims. A trial is the same whoever runs it, so two that come to the same by
//! mistake cost time and nothing else.

mod statements;

use std::time::Duration;

use sqlx::AssertSqlSafe;

use super::StoredTrial;
use super::tables::STRIDE;
use super::trials::{TOO_LONG, long};
use crate::RecordsError;
use crate::query::{Connection, query};
use crate::store::Store;

use statements::{divide, missing, running, store, take};

/// Longest name of a worker, in bytes.
pub const MAX_WORKER: usize = 96;
/// A part that so many workers took and did not come back from is not given to another one.
pub const MAX_LOST: i64 = 10;
/// Most parts that one call claims or renews.
const MAX_PARTS: usize = 1_024;

/// How many seeds the parts of an experiment with `seeds` have.
#[must_use]
pub fn part_size(seeds: u32) -> u32 {
    (seeds / 64).clamp(1, 64)
}

/// A part that a worker holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// Its number among the parts of all experiments.
    pub id: i64,
    /// The experiment.
    pub experiment: i64,
    /// Its trials that are not stored yet, by number within the experiment, with their seeds.
    pub trials: Vec<(u32, u64)>,
}

/// How far an experiment is that runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunningExperiment {
    /// Its number.
    pub id: i64,
    /// The server that counts its trials.
    pub owner: String,
    /// The program that runs it.
    pub build: String,
    /// When it was made: after a backup was put back, another may have its number.
    pub created: i64,
    /// How many trials it is to have.
    pub seeds: u32,
    /// How many trials are counted: the first ones.
    pub done: u32,
    /// Whether the next one is stored.
    pub ready: bool,
    /// Whether it has parts.
    pub divided: bool,
    /// The first trial of a part that no worker came back from.
    pub stuck: Option<u32>,
}

/// What a worker is at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Holder {
    /// The experiment.
    pub experiment: i64,
    /// The worker.
    pub worker: String,
    /// How many seeds it holds.
    pub seeds: u64,
}

/// The parts of experiments among the records.
#[derive(Debug, Clone, Copy)]
pub struct ExperimentParts<'r>(pub(crate) &'r Store);

/// Unix milliseconds by the clock of the database.
const fn now(connection: &Connection<'_>) -> &'static str {
    match connection {
        Connection::Sqlite(_) => {
            "CAST(round((julianday('now') - 2440587.5) * 86400000) AS INTEGER)"
        }
        Connection::Postgres(_) => {
            "CAST(floor(extract(epoch FROM clock_timestamp()) * 1000) AS BIGINT)"
        }
    }
}

fn ms(lease: Duration) -> i64 {
    i64::try_from(lease.as_millis()).unwrap_or(i64::MAX / 4)
}

/// What all numbers of an experiment lie between; `None` where there can be no such experiment.
fn range(experiment: i64) -> Option<(i64, i64)> {
    let first = experiment.checked_mul(STRIDE)?;
    Some((first, first.checked_add(STRIDE)?))
}

fn known(worker: &str) -> Result<String, RecordsError> {
    if worker.is_empty() || worker.len() > MAX_WORKER || worker.contains('\0') {
        return Err(RecordsError::Invalid(
            "a worker has a name of 1 to 96 bytes",
        ));
    }
    Ok(worker.to_owned())
}

/// Numbers of ours, as a list of SQL.
fn list(ids: &[i64]) -> String {
    let ids: Vec<String> = ids.iter().map(i64::to_string).collect();
    ids.join(", ")
}

/// Takes away what is left to do of an experiment.
pub(super) async fn drop_parts(
    connection: &mut Connection<'_>,
    experiment: i64,
) -> Result<(), RecordsError> {
    let Some((first, end)) = range(experiment) else {
        return Ok(());
    };
    query("DELETE FROM experiment_part WHERE id >= $1 AND id < $2")
        .bind(first)
        .bind(end)
        .execute(connection)
        .await?;
    Ok(())
}

impl ExperimentParts<'_> {
    /// Every experiment that runs and has trials, in the order in which they were started.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn running(self) -> Result<Vec<RunningExperiment>, RecordsError> {
        self.0
            .read(|connection| Box::pin(running(connection)))
            .await
    }

    /// What every worker is at that holds something now, by experiment and name of the worker.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn holders(self) -> Result<Vec<Holder>, RecordsError> {
        self.0
            .read(|connection| {
                Box::pin(async move {
                    let sql = format!(
                        "SELECT id / {STRIDE}, worker, CAST(sum(size) AS BIGINT) FROM experiment_part
                         WHERE worker IS NOT NULL AND held_until > {}
                         GROUP BY id / {STRIDE}, worker ORDER BY id / {STRIDE}, worker",
                        now(connection)
                    );
                    let rows: Vec<(i64, String, i64)> =
                        query(AssertSqlSafe(sql)).fetch_all(connection).await?;
                    let holder = |(experiment, worker, seeds): (i64, String, i64)| Holder {
                        experiment,
                        worker,
                        seeds: seeds.cast_unsigned(),
                    };
                    Ok(rows.into_iter().map(holder).collect())
                })
            })
            .await
    }

    /// Divides what is left of an experiment that runs, where nothing of it is divided; its first trial has the seed
    /// `first_seed`.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when it does not run (any more).
    pub async fn divide(self, experiment: i64, first_seed: u64) -> Result<(), RecordsError> {
        self.0
            .write(move |connection| Box::pin(divide(connection, experiment, first_seed)))
            .await
    }

    /// Claims up to `most` parts of an experiment for `worker`, the first that nobody holds, and returns what is to be
    /// done; none when the experiment does not run or is for another `build`. They are the worker's for as long as
    /// `lease`, unless it [renews](Self::renew) that.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be claimed. After [`RecordsError::Unavailable`] they may have been; nobody
    /// gets them then before the lease ends.
    pub async fn claim(
        self,
        worker: &str,
        experiment: i64,
        build: &str,
        most: u32,
        lease: Duration,
    ) -> Result<Vec<Part>, RecordsError> {
        let worker = known(worker)?;
        let build = build.to_owned();
        let most = i64::from(most).min(MAX_PARTS as i64);
        let Some(whole) = range(experiment) else {
            return Ok(Vec::new());
        };
        self.0
            .apart(move |connection| {
                Box::pin(async move {
                    let taken = take(&mut *connection, &worker, whole, &build, most, lease).await?;
                    missing(connection, experiment, taken).await
                })
            })
            .await
    }

    /// Has `worker` hold these parts for as long as `lease` from now, and returns those that it still holds: of the
    /// others the experiment does not run any more, or somebody else has them.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn renew(
        self,
        worker: &str,
        parts: &[i64],
        lease: Duration,
    ) -> Result<Vec<i64>, RecordsError> {
        let worker = known(worker)?;
        if parts.is_empty() {
            return Ok(Vec::new());
        }
        let mut held = Vec::with_capacity(parts.len());
        for some in parts.chunks(MAX_PARTS) {
            let (worker, ids) = (worker.clone(), list(some));
            let renewed = self.0.write(move |connection| {
                Box::pin(async move {
                    let sql = format!(
                        "UPDATE experiment_part SET held_until = {} + $1
                         WHERE worker = $2 AND id IN ({ids}) AND EXISTS (SELECT 1 FROM experiment
                             WHERE experiment.id = experiment_part.id / {STRIDE} AND state = 'running')
                         RETURNING id",
                        now(connection)
                    );
                    let rows: Vec<(i64,)> = query(AssertSqlSafe(sql))
                        .bind(ms(lease))
                        .bind(worker)
                        .fetch_all(connection)
                        .await?;
                    Ok(rows)
                })
            });
            held.extend(renewed.await?.into_iter().map(|(id,)| id));
        }
        held.sort_unstable();
        Ok(held)
    }

    /// Gives back what `worker` holds, of one experiment or of all. What it is `lost` from is counted: it did not come
    /// back from there.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written; others get it when the lease ends.
    pub async fn release(
        self,
        worker: &str,
        experiment: Option<i64>,
        lost: bool,
    ) -> Result<(), RecordsError> {
        let worker = known(worker)?;
        let (first, end) = match experiment.map(range) {
            None => (i64::MIN, i64::MAX),
            Some(Some(range)) => range,
            Some(None) => return Ok(()),
        };
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    query(
                        "UPDATE experiment_part SET worker = NULL, held_until = 0, lost = lost + $1
                         WHERE worker = $2 AND id >= $3 AND id < $4",
                    )
                    .bind(lost)
                    .bind(worker)
                    .bind(first)
                    .bind(end)
                    .execute(connection)
                    .await?;
                    Ok(())
                })
            })
            .await
    }

    /// Stores what trials of an experiment came to that `worker` has claimed, in any order, and returns how many of
    /// them: those that it does not hold (any more) are somebody else's. One that is stored stays as it is.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when the experiment does not run (any more), and [`RecordsError::Invalid`] for what
    /// is no trial of it. Nothing is stored then.
    pub async fn store(
        self,
        worker: &str,
        experiment: i64,
        trials: Vec<StoredTrial>,
    ) -> Result<u32, RecordsError> {
        let worker = known(worker)?;
        if trials.iter().any(long) {
            return Err(TOO_LONG);
        }
        let whole = range(experiment).ok_or(RecordsError::NotFound)?;
        self.0
            .write(move |connection| {
                Box::pin(async move { store(connection, &worker, experiment, whole, trials).await })
            })
            .await
    }

    /// Has `build` run an experiment that does not run and of which nothing is counted. What is stored of it all the
    /// same goes: another program has made that. Returns whether it is so.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn adopt(self, experiment: i64, build: &str) -> Result<bool, RecordsError> {
        let Some((first, end)) = range(experiment) else {
            return Ok(false);
        };
        let build = build.to_owned();
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let changed = query(
                        "UPDATE experiment SET build = $1
                         WHERE id = $2 AND done = 0 AND state IN ('created', 'paused')",
                    )
                    .bind(build)
                    .bind(experiment)
                    .execute(&mut *connection)
                    .await?;
                    if changed == 0 {
                        return Ok(false);
                    }
                    drop_parts(&mut *connection, experiment).await?;
                    query("DELETE FROM trial WHERE id >= $1 AND id < $2")
                        .bind(first)
                        .bind(end)
                        .execute(connection)
                        .await?;
                    Ok(true)
                })
            })
            .await
    }

    /// Has the server `to` count the trials of an experiment that runs, where it is `from` that does. Returns whether
    /// it is.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn hand_over(
        self,
        experiment: i64,
        from: &str,
        to: &str,
    ) -> Result<bool, RecordsError> {
        let (from, to) = (from.to_owned(), to.to_owned());
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let changed = query(
                        "UPDATE experiment SET owner = $1
                         WHERE id = $2 AND owner = $3 AND state = 'running'",
                    )
                    .bind(to)
                    .bind(experiment)
                    .bind(from)
                    .execute(connection)
                    .await?;
                    Ok(changed == 1)
                })
            })
            .await
    }
}
