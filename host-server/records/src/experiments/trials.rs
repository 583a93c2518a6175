//! Trials of experiments in their table.

use sqlx::AssertSqlSafe;

use super::parts::drop_parts;
use super::tables::{MAX_REASON, STRIDE, find};
use super::{ExperimentState, MAX_EXPERIMENT_TEXT, NewTrials, StoredTrial, packed, unpacked};
use crate::RecordsError;
use crate::query::{Connection, query};
use crate::store::Store;
use crate::text::cut;

/// Most metrics.
const MAX_METRICS: usize = 64;
/// What is said of a trial that is [`long`].
pub(super) const TOO_LONG: RecordsError = RecordsError::Invalid("a trial has at most 64 metrics");
/// Trials that go into one statement.
const TOGETHER: usize = 500;

/// The trials of experiments among the records.
#[derive(Debug, Clone, Copy)]
pub struct Trials<'r>(pub(crate) &'r Store);

impl Trials<'_> {
    /// Adds trials that are done.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when the experiment does not run (any more), or others than these
    /// are its next ones.
    pub async fn add(self, new: NewTrials) -> Result<(), RecordsError> {
        if new.results.len() > MAX_EXPERIMENT_TEXT {
            return Err(RecordsError::Invalid("results have at most 64 KiB"));
        }
        if new.trials.iter().any(long) {
            return Err(TOO_LONG);
        }
        self.0
            .write(move |connection| Box::pin(extend(connection, new)))
            .await
    }

    /// Up to `limit` trials of an experiment from number `from`, in their order. From
    /// [`done`](crate::Experiment::done) on there may be gaps, which workers fill in any order.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn page(
        self,
        experiment: i64,
        from: u32,
        limit: u32,
    ) -> Result<Vec<StoredTrial>, RecordsError> {
        type Row = (i64, i64, i64, Option<String>, Vec<u8>);
        let Some(first) = experiment.checked_mul(STRIDE) else {
            return Ok(Vec::new());
        };
        let from = first.saturating_add(i64::from(from).min(STRIDE));
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let rows: Vec<Row> = query(
                        "SELECT id, seed, success, reason, measured FROM trial
                         WHERE id >= $1 AND id < $2 ORDER BY id LIMIT $3",
                    )
                    .bind(from)
                    .bind(first.saturating_add(STRIDE))
                    .bind(i64::from(limit))
                    .fetch_all(connection)
                    .await?;
                    let trial = |(id, seed, success, reason, measured): Row| StoredTrial {
                        number: (id - first) as u32,
                        seed: seed.cast_unsigned(),
                        success: success != 0,
                        reason,
                        measured: unpacked(&measured),
                    };
                    Ok(rows.into_iter().map(trial).collect())
                })
            })
            .await
    }
}

pub(super) async fn insert(
    connection: &mut Connection<'_>,
    experiment: i64,
    trials: &[StoredTrial],
) -> Result<(), RecordsError> {
    for trials in trials.chunks(TOGETHER) {
        let places: Vec<String> = (0..trials.len())
            .map(|row| row * 5)
            .map(|n| {
                format!(
                    "(${}, ${}, ${}, ${}, ${})",
                    n + 1,
                    n + 2,
                    n + 3,
                    n + 4,
                    n + 5
                )
            })
            .collect();
        // Written before, by a call whose answer was lost: a trial is the same whenever it runs.
        let mut insert = query(AssertSqlSafe(format!(
            "INSERT INTO trial (id, seed, success, reason, measured) VALUES {}
             ON CONFLICT (id) DO NOTHING",
            places.join(", ")
        )));
        for trial in trials {
            insert = insert
                .bind(experiment * STRIDE + i64::from(trial.number))
                .bind(trial.seed.cast_signed())
                .bind(trial.success)
                .bind(
                    trial
                        .reason
                        .as_deref()
                        .map(|reason| cut(reason, MAX_REASON)),
                )
                .bind(packed(&trial.measured));
        }
        insert.execute(connection).await?;
    }
    Ok(())
}

/// Whether it has measured more than fits.
pub(super) fn long(trial: &StoredTrial) -> bool {
    trial.measured.len() > MAX_METRICS
}

async fn extend(connection: &mut Connection<'_>, new: NewTrials) -> Result<(), RecordsError> {
    let there = find(&mut *connection, new.experiment).await?;
    let there = there.ok_or(RecordsError::NotFound)?;
    let fits = |(number, trial): (u32, &StoredTrial)| trial.number == number;
    let Some(first) = new.trials.first().map(|trial| trial.number) else {
        return Err(RecordsError::Invalid("trials are at least one"));
    };
    let end = first.saturating_add(new.trials.len() as u32);
    let state = if new.completed.is_some() {
        ExperimentState::Completed
    } else {
        ExperimentState::Running
    };
    // The call before may have come to its end without an answer.
    let again = there.done == end && there.state == state;
    let next = there.done == first && there.state == ExperimentState::Running;
    if !(again || next) || end > there.seeds || !(first..).zip(&new.trials).all(fits) {
        return Err(RecordsError::NotFound);
    }
    insert(&mut *connection, new.experiment, &new.trials).await?;
    query("UPDATE experiment SET done = $1, results = $2, state = $3, ended = $4 WHERE id = $5")
        .bind(i64::from(end))
        .bind(new.results)
        .bind(state.name())
        .bind(new.completed)
        .bind(new.experiment)
        .execute(&mut *connection)
        .await?;
    if new.completed.is_some() {
        drop_parts(connection, new.experiment).await?;
    }
    Ok(())
}
