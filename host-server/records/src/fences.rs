//! Fences: named polygons of the ground. What a good polygon is, whoever keeps one here decides.

use crate::RecordsError;
use crate::query::changed;
use crate::query::{Connection, query};
use crate::store::Store;

/// Most fences.
pub const MAX_FENCES: i64 = 64;
/// Longest name of a fence, in characters.
pub const MAX_FENCE_NAME: usize = 32;
/// Longest text of a fence's corners, in bytes.
const MAX_CORNERS: usize = 4_096;
/// Longest name of who made a fence, in bytes; the rest is cut off.
const MAX_BY: usize = 64;

/// A fence as it is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptFence {
    /// Its id, 1 to 32 characters.
    pub id: String,
    /// Its name; no two have the same.
    pub name: String,
    /// `keep_in` or `keep_out`.
    pub kind: String,
    /// `warn` or `stop`.
    pub action: String,
    /// Its corners, as JSON.
    pub corners: String,
    /// Who made it.
    pub by: String,
    /// When it was made.
    pub made_at: i64,
}

type Row = (String, String, String, String, String, String, i64);

fn fence((id, name, kind, action, corners, by, made_at): Row) -> KeptFence {
    KeptFence {
        id,
        name,
        kind,
        action,
        corners,
        by,
        made_at,
    }
}

fn check(fence: &KeptFence) -> Result<(), RecordsError> {
    let within = |text: &str| (1..=MAX_FENCE_NAME).contains(&text.chars().count());
    if !within(&fence.id) || !within(&fence.name) || fence.name.contains('\0') {
        return Err(RecordsError::Invalid("a fence's name has 1 to 32 letters"));
    }
    if !["keep_in", "keep_out"].contains(&&*fence.kind)
        || !["warn", "stop"].contains(&&*fence.action)
    {
        return Err(RecordsError::Invalid("a fence is of no such kind"));
    }
    if fence.corners.len() > MAX_CORNERS || fence.corners.contains('\0') {
        return Err(RecordsError::Invalid("a fence has too many corners"));
    }
    Ok(())
}

/// Refuses when another fence has this name.
async fn name_is_free(
    connection: &mut Connection<'_>,
    fence: &KeptFence,
) -> Result<(), RecordsError> {
    let other: Option<(String,)> = query("SELECT id FROM fence WHERE name = $1 AND id <> $2")
        .bind(&fence.name)
        .bind(&fence.id)
        .fetch_optional(connection)
        .await?;
    other.map_or(Ok(()), |_| Err(RecordsError::Exists))
}

/// The fences among the records.
#[derive(Debug, Clone, Copy)]
pub struct Fences<'r>(pub(crate) &'r Store);

impl Fences<'_> {
    /// Every fence, the oldest first.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn all(self) -> Result<Vec<KeptFence>, RecordsError> {
        self.0
            .read(|connection| {
                Box::pin(async move {
                    let rows: Vec<Row> = query(
                        "SELECT id, name, kind, action, corners, made_by, made_at FROM fence
                         ORDER BY made_at, id LIMIT $1",
                    )
                    .bind(MAX_FENCES)
                    .fetch_all(connection)
                    .await?;
                    Ok(rows.into_iter().map(fence).collect())
                })
            })
            .await
    }

    /// Keeps a fence.
    ///
    /// # Errors
    /// [`RecordsError::Exists`] when one has its name, [`RecordsError::TooMany`], or
    /// [`RecordsError::Invalid`] for what no fence can be.
    pub async fn add(self, fence: &KeptFence) -> Result<(), RecordsError> {
        check(fence)?;
        let fence = fence.clone();
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let (count,): (i64,) = query("SELECT count(*) FROM fence")
                        .fetch_one(&mut *connection)
                        .await?;
                    if count >= MAX_FENCES {
                        return Err(RecordsError::TooMany("fences"));
                    }
                    name_is_free(connection, &fence).await?;
                    let done = query(
                        "INSERT INTO fence (id, name, kind, action, corners, made_by, made_at)
                         VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT DO NOTHING",
                    )
                    .bind(fence.id)
                    .bind(fence.name)
                    .bind(fence.kind)
                    .bind(fence.action)
                    .bind(fence.corners)
                    .bind(crate::text::cut(&fence.by, MAX_BY))
                    .bind(fence.made_at)
                    .execute(connection)
                    .await?;
                    changed(done, RecordsError::Exists)
                })
            })
            .await
    }

    /// Makes the fence of that id what `fence` says, but for who made it and when. Returns it as it
    /// is kept then.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], or as for [`Fences::add`].
    pub async fn change(self, fence: &KeptFence) -> Result<KeptFence, RecordsError> {
        check(fence)?;
        let changes = fence.clone();
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    name_is_free(connection, &changes).await?;
                    let row: Option<Row> = query(
                        "UPDATE fence SET name = $1, kind = $2, action = $3, corners = $4
                         WHERE id = $5
                         RETURNING id, name, kind, action, corners, made_by, made_at",
                    )
                    .bind(changes.name)
                    .bind(changes.kind)
                    .bind(changes.action)
                    .bind(changes.corners)
                    .bind(changes.id)
                    .fetch_optional(connection)
                    .await?;
                    row.map(self::fence).ok_or(RecordsError::NotFound)
                })
            })
            .await
    }

    /// Forgets a fence; returns its name.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`].
    pub async fn delete(self, id: &str) -> Result<String, RecordsError> {
        let id = id.to_owned();
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let row: Option<(String,)> =
                        query("DELETE FROM fence WHERE id = $1 RETURNING name")
                            .bind(id)
                            .fetch_optional(connection)
                            .await?;
                    row.map(|(name,)| name).ok_or(RecordsError::NotFound)
                })
            })
            .await
    }
}
