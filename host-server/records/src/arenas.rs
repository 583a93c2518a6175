//! What the simulated arena was, by time.

use crate::query::query;
use crate::{Records, RecordsError};

/// Most bytes of an arena.
pub const MAX_ARENA: usize = 1_048_576;

impl Records {
    /// Notes that the simulated arena is `arena` from `at` on; `None` where there is none. One that is
    /// as it was is not noted again.
    ///
    /// # Errors
    /// [`RecordsError::Invalid`] for one of more than [`MAX_ARENA`] bytes, others when it cannot be
    /// written.
    pub async fn add_arena(&self, at: i64, arena: Option<String>) -> Result<(), RecordsError> {
        if arena.as_ref().is_some_and(|arena| arena.len() > MAX_ARENA) {
            return Err(RecordsError::Invalid("an arena has at most 1 MiB"));
        }
        self.db()
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
    pub async fn arena_at(&self, at: i64) -> Result<Option<String>, RecordsError> {
        self.db()
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
    pub async fn arenas(
        &self,
        from: i64,
        to: i64,
        step: i64,
    ) -> Result<Vec<(i64, Option<String>)>, RecordsError> {
        self.db()
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
}
