//! What is done to parts, statement by statement.

use std::time::Duration;

use sqlx::AssertSqlSafe;

use super::{MAX_LOST, Part, RunningExperiment, list, ms, now, part_size, range};
use crate::RecordsError;
use crate::experiments::tables::{STRIDE, find};
use crate::experiments::trials::insert;
use crate::experiments::{ExperimentState, MAX_SEEDS, StoredTrial};
use crate::query::{Connection, query};

pub(super) async fn running(
    connection: &mut Connection<'_>,
) -> Result<Vec<RunningExperiment>, RecordsError> {
    type Row = (i64, String, String, i64, i64, i64, i64, i64, i64);
    // Two ends of the numbers of an experiment.
    let of = format!("id >= e.id * {STRIDE} AND id < (e.id + 1) * {STRIDE}");
    let sql = format!(
        "SELECT e.id, e.owner, e.build, e.created, e.seeds, e.done,
             CAST(CASE WHEN EXISTS (SELECT 1 FROM trial WHERE id = e.id * {STRIDE} + e.done)
                 THEN 1 ELSE 0 END AS BIGINT),
             CAST(CASE WHEN EXISTS (SELECT 1 FROM experiment_part WHERE {of})
                 THEN 1 ELSE 0 END AS BIGINT),
             coalesce((SELECT min(id) FROM experiment_part
                 WHERE {of} AND lost >= {MAX_LOST} AND held_until <= {}), -1)
         FROM experiment AS e WHERE e.state = 'running' AND e.kind = 'evaluation' ORDER BY e.started, e.id",
        now(connection)
    );
    let rows: Vec<Row> = query(AssertSqlSafe(sql)).fetch_all(connection).await?;
    let row =
        |(id, owner, build, created, seeds, done, ready, divided, stuck): Row| RunningExperiment {
            id,
            owner,
            build,
            created,
            seeds: seeds as u32,
            done: done as u32,
            ready: ready != 0,
            divided: divided != 0,
            stuck: (stuck >= 0).then_some((stuck % STRIDE) as u32),
        };
    Ok(rows.into_iter().map(row).collect())
}

pub(super) async fn divide(
    connection: &mut Connection<'_>,
    id: i64,
    first_seed: u64,
) -> Result<(), RecordsError> {
    /// Parts that go into one statement.
    const TOGETHER: usize = 500;
    let experiment = find(&mut *connection, id).await?;
    let experiment = experiment.filter(|there| there.state == ExperimentState::Running);
    let experiment = experiment.ok_or(RecordsError::NotFound)?;
    let (first, end) = range(id).ok_or(RecordsError::NotFound)?;
    let (there,): (i64,) = query("SELECT count(*) FROM experiment_part WHERE id >= $1 AND id < $2")
        .bind(first)
        .bind(end)
        .fetch_one(&mut *connection)
        .await?;
    if there > 0 {
        return Ok(());
    }
    let size = part_size(experiment.seeds);
    let parts: Vec<u32> = (experiment.done..experiment.seeds.min(MAX_SEEDS))
        .step_by(size as usize)
        .collect();
    for parts in parts.chunks(TOGETHER) {
        let rows = parts.iter().map(|&number| {
            let seed = first_seed.wrapping_add(number.into()).cast_signed();
            let size = size.min(experiment.seeds - number);
            format!("({}, {size}, {seed})", first + i64::from(number))
        });
        let rows: Vec<String> = rows.collect();
        let sql = format!(
            "INSERT INTO experiment_part (id, size, seed) VALUES {}",
            rows.join(", ")
        );
        query(AssertSqlSafe(sql)).execute(&mut *connection).await?;
    }
    Ok(())
}

/// Parts that are the worker's from now on: number, size, and first seed.
pub(super) async fn take(
    connection: &mut Connection<'_>,
    worker: &str,
    (first, end): (i64, i64),
    build: &str,
    most: i64,
    lease: Duration,
) -> Result<Vec<(i64, i64, i64)>, RecordsError> {
    let now = now(connection);
    // Whoever claims at the same time takes others instead of waiting for these. A file has one writer.
    let skip = match connection {
        Connection::Sqlite(_) => "",
        Connection::Postgres(_) => "FOR UPDATE SKIP LOCKED",
    };
    let sql = format!(
        "WITH free (part) AS MATERIALIZED (
             SELECT id FROM experiment_part
             WHERE id >= $1 AND id < $2 AND lost < {MAX_LOST}
                 AND (worker IS NULL OR held_until <= {now})
                 AND EXISTS (SELECT 1 FROM experiment
                     WHERE experiment.id = $3 AND state = 'running' AND build = $4)
             ORDER BY id LIMIT $5 {skip})
         UPDATE experiment_part SET worker = $6, held_until = {now} + $7,
             lost = lost + CASE WHEN worker IS NULL THEN 0 ELSE 1 END
         FROM free WHERE id = part RETURNING id, size, seed"
    );
    let mut taken: Vec<(i64, i64, i64)> = query(AssertSqlSafe(sql))
        .bind(first)
        .bind(end)
        .bind(first / STRIDE)
        .bind(build)
        .bind(most)
        .bind(worker)
        .bind(ms(lease))
        .fetch_all(connection)
        .await?;
    taken.sort_unstable();
    Ok(taken)
}

/// What of these parts is not stored. One of which everything is goes.
pub(super) async fn missing(
    connection: &mut Connection<'_>,
    experiment: i64,
    parts: Vec<(i64, i64, i64)>,
) -> Result<Vec<Part>, RecordsError> {
    if parts.is_empty() {
        return Ok(Vec::new());
    }
    let within = parts
        .iter()
        .map(|(id, size, _)| format!("id >= {id} AND id < {}", id + size));
    let within: Vec<String> = within.collect();
    let sql = format!(
        "SELECT id FROM trial WHERE {} ORDER BY id",
        within.join(" OR ")
    );
    let stored: Vec<(i64,)> = query(AssertSqlSafe(sql))
        .fetch_all(&mut *connection)
        .await?;
    let part = |(id, size, seed): (i64, i64, i64)| {
        let left = (0..size).filter(|offset| stored.binary_search(&(id + offset,)).is_err());
        let trial = |offset: i64| {
            let seed = seed.cast_unsigned().wrapping_add(offset.cast_unsigned());
            ((id + offset - experiment * STRIDE) as u32, seed)
        };
        Part {
            id,
            experiment,
            trials: left.map(trial).collect(),
        }
    };
    let parts = parts.into_iter().map(part);
    let (left, done): (Vec<_>, Vec<_>) = parts.partition(|part| !part.trials.is_empty());
    if !done.is_empty() {
        let done: Vec<i64> = done.iter().map(|part| part.id).collect();
        let sql = format!("DELETE FROM experiment_part WHERE id IN ({})", list(&done));
        query(AssertSqlSafe(sql)).execute(connection).await?;
    }
    Ok(left)
}

pub(super) async fn store(
    connection: &mut Connection<'_>,
    worker: &str,
    experiment: i64,
    (first, end): (i64, i64),
    trials: Vec<StoredTrial>,
) -> Result<u32, RecordsError> {
    let there = find(&mut *connection, experiment).await?;
    if there.is_none_or(|there| there.state != ExperimentState::Running) {
        return Err(RecordsError::NotFound);
    }
    let parts: Vec<(i64, i64, i64)> = query(
        "SELECT id, size, seed FROM experiment_part
         WHERE worker = $1 AND id >= $2 AND id < $3 ORDER BY id",
    )
    .bind(worker)
    .bind(first)
    .bind(end)
    .fetch_all(&mut *connection)
    .await?;
    let mut own = Vec::with_capacity(trials.len());
    let mut changed = Vec::new();
    for trial in trials {
        let id = first + i64::from(trial.number);
        let before = parts.partition_point(|(part, _, _)| *part <= id);
        let part = before.checked_sub(1).and_then(|index| parts.get(index));
        let Some(&(part, size, seed)) = part.filter(|(part, size, _)| id < part + size) else {
            continue;
        };
        let offset = (id - part).cast_unsigned();
        if trial.seed != seed.cast_unsigned().wrapping_add(offset) {
            return Err(RecordsError::Invalid(
                "a trial of another experiment: it has another seed",
            ));
        }
        changed.push((part, size));
        own.push(trial);
    }
    changed.sort_unstable();
    changed.dedup();
    insert(&mut *connection, experiment, &own).await?;
    for (part, size) in changed {
        query(
            "DELETE FROM experiment_part WHERE id = $1 AND size =
                 (SELECT count(*) FROM trial WHERE id >= $1 AND id < $2)",
        )
        .bind(part)
        .bind(part + size)
        .execute(&mut *connection)
        .await?;
    }
    Ok(own.len() as u32)
}
