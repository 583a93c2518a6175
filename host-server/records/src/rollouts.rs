//! Rollouts: what each is to do, where its robots stand, what has happened, and which server carries it out.
//!
//! A rollout belongs to one server at a time, by [`KeptRollout::epoch`], which rises each time it goes to another
//! one. Who writes under an earlier epoch is refused in the same transaction, so a server that was stopped for long
//! and comes back changes nothing any more. While a server lives it makes [`Lease::beat`] rise; whoever has not seen
//! that for a while, by its own clock, takes the rollout over.

mod lease;
mod steps;

use sqlx::AssertSqlSafe;

use crate::RecordsError;
use crate::query::{Connection, query};
use crate::store::Store;

pub use lease::{Lease, Taken};
pub use steps::{NewRollout, RolloutRobot, RolloutStep, StepNote, Written};

/// Most rollouts that are kept; the oldest that are over make room.
pub const MAX_ROLLOUTS: i64 = 200;
/// Most rollouts that are not over.
pub const MAX_ROLLOUTS_AT_WORK: i64 = 16;
/// Longest document of a rollout, in bytes.
pub const MAX_ROLLOUT_DOCUMENT: usize = 2 << 20;
/// Longest entry of a robot, or of a note, in bytes.
pub const MAX_ROLLOUT_ENTRY: usize = 4_096;
/// Most robots in one answer: a thousand, and one that shows that there are more.
pub const MAX_ROLLOUT_PAGE: u32 = 1_001;

/// A rollout, without its robots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptRollout {
    /// Its number; later ones have greater ones.
    pub id: i64,
    /// Who asked for it.
    pub by: String,
    /// When, as Unix milliseconds.
    pub made: i64,
    /// When it ended, as Unix milliseconds.
    pub ended: Option<i64>,
    /// The server that it belongs to.
    pub owner: String,
    /// Rises each time it goes to another server.
    pub epoch: u64,
    /// What it is to do and how far it is.
    pub document: String,
}

type Row = (i64, String, i64, Option<i64>, String, i64, String);

const COLUMNS: &str = "id, made_by, made, ended, owner, epoch, document";

fn kept((id, by, made, ended, owner, epoch, document): Row) -> KeptRollout {
    KeptRollout {
        id,
        by,
        made,
        ended,
        owner,
        epoch: epoch.cast_unsigned(),
        document,
    }
}

async fn find(
    connection: &mut Connection<'_>,
    id: i64,
) -> Result<Option<KeptRollout>, RecordsError> {
    let sql = format!("SELECT {COLUMNS} FROM rollout WHERE id = $1");
    let row: Option<Row> = query(AssertSqlSafe(sql))
        .bind(id)
        .fetch_optional(connection)
        .await?;
    Ok(row.map(kept))
}

/// What all places of a rollout lie between.
fn places(id: i64) -> (String, String) {
    // '0' is what follows '/'.
    (format!("{id}/"), format!("{id}0"))
}

/// Every robot of a rollout, by name.
async fn robots(connection: &mut Connection<'_>, id: i64) -> Result<Vec<String>, RecordsError> {
    let (from, to) = places(id);
    let rows: Vec<(String,)> =
        query("SELECT entry FROM rollout_robot WHERE place > $1 AND place < $2 ORDER BY place")
            .bind(from)
            .bind(to)
            .fetch_all(connection)
            .await?;
    Ok(rows.into_iter().map(|(entry,)| entry).collect())
}

/// The rollouts among the records.
#[derive(Debug, Clone, Copy)]
pub struct Rollouts<'r>(pub(crate) &'r Store);

impl Rollouts<'_> {
    /// A rollout.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn get(self, id: i64) -> Result<Option<KeptRollout>, RecordsError> {
        self.0
            .read(move |connection| Box::pin(find(connection, id)))
            .await
    }

    /// Up to `limit` rollouts before number `before`, or the last ones, newest first.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn page(
        self,
        before: Option<i64>,
        limit: u32,
    ) -> Result<Vec<KeptRollout>, RecordsError> {
        let sql = format!("SELECT {COLUMNS} FROM rollout WHERE id < $1 ORDER BY id DESC LIMIT $2");
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let rows: Vec<Row> = query(AssertSqlSafe(sql))
                        .bind(before.unwrap_or(i64::MAX))
                        .bind(i64::from(limit).min(MAX_ROLLOUTS))
                        .fetch_all(connection)
                        .await?;
                    Ok(rows.into_iter().map(kept).collect())
                })
            })
            .await
    }

    /// A rollout, and the entries of all its robots by name of the robot. A step that is written meanwhile may show
    /// in some of them.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn whole(self, id: i64) -> Result<Option<(KeptRollout, Vec<String>)>, RecordsError> {
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let Some(rollout) = find(connection, id).await? else {
                        return Ok(None);
                    };
                    Ok(Some((rollout, robots(connection, id).await?)))
                })
            })
            .await
    }

    /// The entries of up to `limit` robots of a rollout behind the robot `after`, by name, at most
    /// [`MAX_ROLLOUT_PAGE`]; only of those in `state` where one is named.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn robots(
        self,
        id: i64,
        after: Option<&str>,
        state: Option<&str>,
        limit: u32,
    ) -> Result<Vec<String>, RecordsError> {
        let (first, to) = places(id);
        let from = format!("{first}{}", after.unwrap_or_default());
        let state = state.map(str::to_owned);
        let limit = i64::from(limit.min(MAX_ROLLOUT_PAGE));
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let select = match state {
                        None => query(
                            "SELECT entry FROM rollout_robot WHERE place > $1 AND place < $2
                             ORDER BY place LIMIT $3",
                        ),
                        Some(_) => query(
                            "SELECT entry FROM rollout_robot WHERE place > $1 AND place < $2
                             AND state = $4 ORDER BY place LIMIT $3",
                        ),
                    };
                    let mut select = select.bind(from).bind(to).bind(limit);
                    if let Some(state) = state {
                        select = select.bind(state);
                    }
                    let rows: Vec<(String,)> = select.fetch_all(connection).await?;
                    Ok(rows.into_iter().map(|(entry,)| entry).collect())
                })
            })
            .await
    }

    /// The entry of one robot of a rollout.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn robot(self, id: i64, robot: &str) -> Result<Option<String>, RecordsError> {
        let place = format!("{id}/{robot}");
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let row: Option<(String,)> =
                        query("SELECT entry FROM rollout_robot WHERE place = $1")
                            .bind(place)
                            .fetch_optional(connection)
                            .await?;
                    Ok(row.map(|(entry,)| entry))
                })
            })
            .await
    }

    /// What has happened to a robot of a rollout, or to the rollout itself, oldest first, with the time of each: the
    /// last `limit`, at most [`MAX_ROLLOUT_PAGE`].
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn notes(
        self,
        id: i64,
        robot: Option<&str>,
        limit: u32,
    ) -> Result<Vec<(i64, String)>, RecordsError> {
        let robot = robot.unwrap_or_default();
        let (from, to) = (format!("{id}/{robot}/"), format!("{id}/{robot}0"));
        let limit = i64::from(limit.min(MAX_ROLLOUT_PAGE));
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let mut rows: Vec<(i64, String)> = query(
                        "SELECT at, what FROM rollout_note WHERE place > $1 AND place < $2
                         ORDER BY place DESC LIMIT $3",
                    )
                    .bind(from)
                    .bind(to)
                    .bind(limit)
                    .fetch_all(connection)
                    .await?;
                    rows.reverse();
                    Ok(rows)
                })
            })
            .await
    }
}
