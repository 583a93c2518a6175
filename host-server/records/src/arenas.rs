//! What the simulated arena was, by time.

use crate::RecordsError;
use crate::query::query;
use crate::store::Store;

/// Most bytes of an arena.
pub const MAX_ARENA: usize = 1_048_576;

/// The simulated arenas among the records.
#[derive(Debug, Clone, Copy)]
pub struct Arenas<'r>(pub(crate) &'r Store);

impl Arenas<'_> {
    /// Notes that the simulated arena is `arena` from `at` on; `None` where there is none. One that is
    /// as it was is not noted again.
    ///
    /// # Errors
    /// [`RecordsError::Invalid`] for one of more than [`MAX_ARENA`] bytes, others when it cannot be
    /// written.
    pub async fn add(self, at: i64, arena: Option<String>) -> Result<(), RecordsError> {
        if arena.as_ref().is_some_and(|arena| arena.len() > MAX_ARENA) {
            return Err(RecordsError::Invalid("an arena has at most 1 MiB"));
        }
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let last: Option<(Option<String>,)> =
                        query("SELECT data FROM arena ORDER BY at DESC, id DESC LIMIT 1")
                            .fetch_optional(connection)
                            .await?;
                    // Before the first there was none.
                    if last.map_or(arena.is_none(), |(last,)| last == arena) {
                        return Ok(());
                    }
                    query("INSERT INTO arena (at, data) VALUES ($1, $2)")
                        .bind(at)
                        .bind(arena)
                        .execute(connection)
                        .await?;
                    Ok(())
                })
            })
            .await
    }

    /// What the simulated arena was at `at`; `None` where there was none.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn at(self, at: i64) -> Result<Option<String>, RecordsError> {
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let row: Option<(Option<String>,)> = query(
                        "SELECT data FROM arena WHERE at <= $1 ORDER BY at DESC, id DESC LIMIT 1",
                    )
                    .bind(at)
                    .fetch_optional(connection)
                    .await?;
                    Ok(row.and_then(|(data,)| data))
                })
            })
            .await
    }

    /// How the simulated arena changed after `from` and before `to`, oldest first: of the changes
    /// within the same `step` milliseconds the last.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn changes(
        self,
        from: i64,
        to: i64,
        step: i64,
    ) -> Result<Vec<(i64, Option<String>)>, RecordsError> {
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    query(
                        "SELECT at, data FROM arena WHERE id IN
                         (SELECT max(id) FROM arena WHERE at > $1 AND at < $2 GROUP BY at / $3)
                         ORDER BY at, id",
                    )
                    .bind(from)
                    .bind(to)
                    .bind(step.max(1))
                    .fetch_all(connection)
                    .await
                })
            })
            .await
    }

    /// Deletes those from before `before` and all but the newest `most`, and returns how many: but not the one of
    /// the earliest time that is kept. What would take long is left for the next call.
    pub(crate) async fn prune(self, before: i64, most: i64) -> Result<u64, RecordsError> {
        let old = "DELETE FROM arena WHERE id IN
                 (SELECT id FROM arena
                  WHERE at < (SELECT max(at) FROM arena WHERE at <= $1) ORDER BY at LIMIT $2)";
        let many = "DELETE FROM arena WHERE id IN
                 (SELECT id FROM arena
                  WHERE id <= (SELECT coalesce(max(id), 0) FROM arena) - $1 ORDER BY id LIMIT $2)";
        let deleted = self.0.delete_some(old, before).await?;
        Ok(deleted + self.0.delete_some(many, most).await?)
    }
}
