//! Experiments and trials in their tables.

use sqlx::AssertSqlSafe;

use super::parts::drop_parts;
use super::{
    Experiment, ExperimentKind, ExperimentState, MAX_EXPERIMENT_TEXT, MAX_EXPERIMENTS, MAX_SEEDS,
    MAX_TRAININGS, MAX_TRIALS, NewExperiment,
};
use crate::RecordsError;
use crate::query::{Connection, query};
use crate::store::Store;
use crate::text::cut;

/// Longest name of an experiment, in characters.
const MAX_NAME: usize = 64;
/// Longest name of who made it, and of the server that counts its trials, in bytes; the rest is cut off.
const MAX_BY: usize = 64;
/// Longest name of a program, in bytes; the rest is cut off.
const MAX_BUILD: usize = 96;
/// Longest reason, in bytes; the rest is cut off.
pub(super) const MAX_REASON: usize = 512;
/// Numbers of trials of one experiment: more than it can have.
pub(super) const STRIDE: i64 = 1 << 20;
/// Setting with the number of the newest experiment: one that was deleted does not come back.
const NEWEST: &str = "experiment.newest";

type Row = (
    i64,
    String,
    String,
    String,
    String,
    String,
    i64,
    String,
    i64,
    Option<i64>,
    Option<i64>,
    String,
    Option<String>,
    i64,
    String,
    String,
);

const COLUMNS: &str = "id, owner, name, recipe, metrics, results, seeds, made_by, created, started, \
                       ended, state, reason, done, build, kind";

fn experiment(row: Row) -> Result<Experiment, RecordsError> {
    let (
        id,
        owner,
        name,
        recipe,
        metrics,
        results,
        seeds,
        by,
        created,
        started,
        ended,
        state,
        reason,
        done,
        build,
        kind,
    ) = row;
    let count = |number: i64| {
        u32::try_from(number)
            .map_err(|_| RecordsError::Invalid("an invalid number of an experiment is stored"))
    };
    Ok(Experiment {
        id,
        kind: kind.parse()?,
        owner,
        name,
        recipe,
        metrics,
        results,
        seeds: count(seeds)?,
        by,
        created,
        started,
        ended,
        state: state.parse()?,
        reason,
        done: count(done)?,
        build,
    })
}

pub(super) async fn find(
    connection: &mut Connection<'_>,
    id: i64,
) -> Result<Option<Experiment>, RecordsError> {
    let sql = format!("SELECT {COLUMNS} FROM experiment WHERE id = $1");
    let row: Option<Row> = query(AssertSqlSafe(sql))
        .bind(id)
        .fetch_optional(connection)
        .await?;
    row.map(experiment).transpose()
}

/// A number that no experiment had before.
async fn next_id(connection: &mut Connection<'_>) -> Result<i64, RecordsError> {
    let kept: Option<(Vec<u8>,)> = query("SELECT value FROM setting WHERE key = $1")
        .bind(NEWEST)
        .fetch_optional(&mut *connection)
        .await?;
    let kept = kept.and_then(|(value,)| String::from_utf8(value).ok()?.parse::<i64>().ok());
    let (there,): (i64,) = query("SELECT coalesce(max(id), 0) FROM experiment")
        .fetch_one(&mut *connection)
        .await?;
    let id = kept.unwrap_or(0).max(there) + 1;
    query(
        "INSERT INTO setting (key, value) VALUES ($1, $2)
         ON CONFLICT (key) DO UPDATE SET value = excluded.value",
    )
    .bind(NEWEST)
    .bind(id.to_string().into_bytes())
    .execute(connection)
    .await?;
    Ok(id)
}

/// The experiments among the records.
#[derive(Debug, Clone, Copy)]
pub struct Experiments<'r>(pub(crate) &'r Store);

impl Experiments<'_> {
    /// Makes an experiment and returns it.
    ///
    /// # Errors
    /// [`RecordsError::TooMany`], or [`RecordsError::Invalid`] for what is too long.
    pub async fn add(self, new: NewExperiment) -> Result<Experiment, RecordsError> {
        if new.name.is_empty() || new.name.chars().count() > MAX_NAME || new.name.contains('\0') {
            return Err(RecordsError::Invalid(
                "an experiment has a name of 1 to 64 characters",
            ));
        }
        if new.recipe.len().max(new.metrics.len()) > MAX_EXPERIMENT_TEXT {
            return Err(RecordsError::Invalid("a recipe has at most 64 KiB"));
        }
        if !(1..=MAX_SEEDS).contains(&new.seeds) {
            return Err(RecordsError::Invalid("an experiment has 1 to 100000 seeds"));
        }
        self.0
            .write(move |connection| Box::pin(add(connection, new)))
            .await
    }

    /// The experiment of that number.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn get(self, id: i64) -> Result<Option<Experiment>, RecordsError> {
        self.0
            .read(move |connection| Box::pin(find(connection, id)))
            .await
    }

    /// Up to `limit` experiments before number `before`, or the last ones, newest first.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn page(
        self,
        before: Option<i64>,
        limit: u32,
    ) -> Result<Vec<Experiment>, RecordsError> {
        let newest = "id < $1 ORDER BY id DESC LIMIT $2";
        list(self.0, newest, before.unwrap_or(i64::MAX), limit.into()).await
    }

    /// Every experiment in `state`, in the order in which they were started.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn in_state(self, state: ExperimentState) -> Result<Vec<Experiment>, RecordsError> {
        // The name is one of ours, no text of others.
        let which = format!("state = '{state}' AND id >= $1 ORDER BY started, id LIMIT $2");
        list(self.0, &which, 0, MAX_EXPERIMENTS).await
    }

    /// How many experiments there are in each state, for each server that has some.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn by_state(self) -> Result<Vec<(String, ExperimentState, u64)>, RecordsError> {
        self.0
            .read(|connection| {
                Box::pin(async move {
                    let rows: Vec<(String, String, i64)> = query(
                        "SELECT owner, state, count(*) FROM experiment GROUP BY owner, state",
                    )
                    .fetch_all(connection)
                    .await?;
                    let count = |(owner, state, count): (String, String, i64)| {
                        Ok((owner, state.parse()?, count.cast_unsigned()))
                    };
                    rows.into_iter().map(count).collect()
                })
            })
            .await
    }

    /// Brings an experiment from one state to another, and returns what it is then. `reason` says
    /// why; the first start and the end are noted with `now`.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when there is none, or it is not in the state `from` (any more).
    pub async fn change_state(
        self,
        id: i64,
        from: ExperimentState,
        to: ExperimentState,
        reason: Option<&str>,
        now: i64,
    ) -> Result<Experiment, RecordsError> {
        let reason = reason.map(|reason| cut(reason, MAX_REASON));
        let started = (to == ExperimentState::Running).then_some(now);
        let ended = to.is_over().then_some(now);
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    query(
                        "UPDATE experiment SET state = $1, reason = $2,
                         started = coalesce(started, $3), ended = $4 WHERE id = $5 AND state = $6",
                    )
                    .bind(to.name())
                    .bind(reason)
                    .bind(started)
                    .bind(ended)
                    .bind(id)
                    .bind(from.name())
                    .execute(&mut *connection)
                    .await
                    .and_then(|done| crate::query::changed(done, RecordsError::NotFound))?;
                    if to.is_over() {
                        drop_parts(&mut *connection, id).await?;
                    }
                    find(connection, id).await?.ok_or(RecordsError::NotFound)
                })
            })
            .await
    }

    /// Every training that runs, in the order in which they were started.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn running_trainings(self) -> Result<Vec<Experiment>, RecordsError> {
        list(
            self.0,
            "kind = 'training' AND state = 'running' AND id >= $1 ORDER BY started, id LIMIT $2",
            0,
            MAX_TRAININGS,
        )
        .await
    }

    /// Notes how many rounds of a training that is not over are kept, and what they came to.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when there is none, or it is over, and [`RecordsError::Invalid`] for
    /// what is too long.
    pub async fn note_training(
        self,
        id: i64,
        done: u32,
        results: String,
    ) -> Result<(), RecordsError> {
        if results.len() > MAX_EXPERIMENT_TEXT {
            return Err(RecordsError::Invalid("results have at most 64 KiB"));
        }
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    query(
                        "UPDATE experiment SET done = $1, results = $2
                         WHERE id = $3 AND kind = 'training' AND state IN ('running', 'paused') AND seeds >= $1",
                    )
                    .bind(i64::from(done))
                    .bind(results)
                    .bind(id)
                    .execute(connection)
                    .await
                    .and_then(|done| crate::query::changed(done, RecordsError::NotFound))
                })
            })
            .await
    }

    /// Deletes an experiment that does not run, with its trials.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when there is none, or it runs.
    pub async fn delete(self, id: i64) -> Result<(), RecordsError> {
        let first = id.checked_mul(STRIDE).ok_or(RecordsError::NotFound)?;
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    query("DELETE FROM experiment WHERE id = $1 AND state <> 'running'")
                        .bind(id)
                        .execute(&mut *connection)
                        .await
                        .and_then(|done| crate::query::changed(done, RecordsError::NotFound))?;
                    drop_parts(&mut *connection, id).await?;
                    query("DELETE FROM trial WHERE id >= $1 AND id < $2")
                        .bind(first)
                        .bind(first.saturating_add(STRIDE))
                        .execute(connection)
                        .await?;
                    Ok(())
                })
            })
            .await
    }
}

/// Experiments by a condition of ours, with a bound and a limit.
async fn list(
    store: &Store,
    which: &str,
    bound: i64,
    limit: i64,
) -> Result<Vec<Experiment>, RecordsError> {
    let sql = format!("SELECT {COLUMNS} FROM experiment WHERE {which}");
    store
        .read(move |connection| {
            Box::pin(async move {
                let rows: Vec<Row> = query(AssertSqlSafe(sql))
                    .bind(bound)
                    .bind(limit)
                    .fetch_all(connection)
                    .await?;
                rows.into_iter().map(experiment).collect()
            })
        })
        .await
}

async fn add(
    connection: &mut Connection<'_>,
    new: NewExperiment,
) -> Result<Experiment, RecordsError> {
    let (count, trainings, trials): (i64, i64, i64) = query(
        "SELECT count(*), CAST(coalesce(sum(CASE kind WHEN 'training' THEN 1 ELSE 0 END), 0) AS BIGINT),
             CAST(coalesce(sum(CASE kind WHEN 'training' THEN 0 ELSE seeds END), 0) AS BIGINT)
         FROM experiment",
    )
    .fetch_one(&mut *connection)
    .await?;
    if count >= MAX_EXPERIMENTS {
        return Err(RecordsError::TooMany("experiments"));
    }
    let is_training = new.kind == ExperimentKind::Training;
    if is_training && trainings >= MAX_TRAININGS {
        return Err(RecordsError::TooMany("trainings"));
    }
    if !is_training && trials + i64::from(new.seeds) > MAX_TRIALS {
        return Err(RecordsError::TooMany("trials of experiments"));
    }
    let id = next_id(&mut *connection).await?;
    let state = if new.start {
        ExperimentState::Running
    } else {
        ExperimentState::Created
    };
    query(
        "INSERT INTO experiment (id, owner, name, recipe, metrics, results, seeds, made_by, created,
         started, state, done, build, kind)
         VALUES ($1, $2, $3, $4, $5, '', $6, $7, $8, $9, $10, 0, $11, $12)",
    )
    .bind(id)
    .bind(cut(&new.owner, MAX_BY))
    .bind(new.name)
    .bind(new.recipe)
    .bind(new.metrics)
    .bind(i64::from(new.seeds))
    .bind(cut(&new.by, MAX_BY))
    .bind(new.created)
    .bind(new.start.then_some(new.created))
    .bind(state.name())
    .bind(cut(&new.build, MAX_BUILD))
    .bind(new.kind.name())
    .execute(&mut *connection)
    .await?;
    find(connection, id).await?.ok_or(RecordsError::NotFound)
}
