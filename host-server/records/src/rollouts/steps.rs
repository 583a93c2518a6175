//! Steps of rollouts: each is written as a whole or not at all, by the server that the rollout belongs to.

use sqlx::AssertSqlSafe;

use super::lease::MAX_OWNER;
use super::{
    MAX_ROLLOUT_DOCUMENT, MAX_ROLLOUT_ENTRY, MAX_ROLLOUTS, MAX_ROLLOUTS_AT_WORK, Rollouts, places,
};
use crate::RecordsError;
use crate::audit::{Entry, append_all};
use crate::query::{Connection, query};
use crate::text::cut;
use crawler_protocol::RobotId;

/// Longest name of who asked for a rollout, in bytes; the rest is cut off.
const MAX_BY: usize = 64;
/// Rows in one statement.
const AT_ONCE: usize = 100;

/// Where a robot of a rollout stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RolloutRobot {
    /// The robot.
    pub robot: RobotId,
    /// The name of its state.
    pub state: String,
    /// All of it.
    pub entry: String,
}

/// Something that has happened in a rollout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepNote {
    /// The robot, if it is about one.
    pub robot: Option<RobotId>,
    /// With the robot it names the note among all of the rollout.
    pub revision: u32,
    /// What has happened.
    pub what: String,
}

/// What is written at once.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RolloutStep {
    /// When, as Unix milliseconds.
    pub at: i64,
    /// The rollout, if anything about it has changed.
    pub document: Option<String>,
    /// Whether it is over, with that document.
    pub over: bool,
    /// Robots of which anything has changed.
    pub robots: Vec<RolloutRobot>,
    /// What has happened.
    pub notes: Vec<StepNote>,
    /// What the audit log says of the notes.
    pub audit: Vec<Entry>,
}

/// A rollout that begins.
#[derive(Debug, Clone, PartialEq)]
pub struct NewRollout {
    /// Its number, from [`Rollouts::next_id`].
    pub id: i64,
    /// Who asked for it.
    pub by: String,
    /// The server that it belongs to, under epoch 1.
    pub owner: String,
    /// Its first step, which has a document.
    pub step: RolloutStep,
}

/// What came of [`Rollouts::write`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Written {
    /// It is on disk.
    Stored,
    /// The rollout is another server's. Nothing was written.
    Lost,
}

impl RolloutStep {
    fn check(&self) -> Result<(), RecordsError> {
        let document = self.document.as_ref().map_or(0, String::len);
        let robots = self.robots.iter().map(|robot| robot.entry.len());
        let notes = self.notes.iter().map(|note| note.what.len());
        let longest = robots.chain(notes).max().unwrap_or(0);
        if document > MAX_ROLLOUT_DOCUMENT || longest > MAX_ROLLOUT_ENTRY {
            return Err(RecordsError::Invalid("a rollout is too long to be kept"));
        }
        Ok(())
    }
}

/// `(…), (…)` for `count` rows of `columns` values.
fn values(count: usize, columns: usize) -> String {
    let row = |row: usize| {
        let places: Vec<String> = (1..=columns)
            .map(|column| format!("${}", row * columns + column))
            .collect();
        format!("({})", places.join(", "))
    };
    (0..count).map(row).collect::<Vec<_>>().join(", ")
}

async fn write_robots(
    connection: &mut Connection<'_>,
    id: i64,
    robots: Vec<RolloutRobot>,
) -> Result<(), RecordsError> {
    for robots in robots.chunks(AT_ONCE) {
        let mut insert = query(AssertSqlSafe(format!(
            "INSERT INTO rollout_robot (place, state, entry) VALUES {}
             ON CONFLICT (place) DO UPDATE SET state = excluded.state, entry = excluded.entry",
            values(robots.len(), 3)
        )));
        for robot in robots {
            insert = insert
                .bind(format!("{id}/{}", robot.robot))
                .bind(&robot.state)
                .bind(&robot.entry);
        }
        insert.execute(connection).await?;
    }
    Ok(())
}

/// Whether any of the notes is new.
async fn write_notes(
    connection: &mut Connection<'_>,
    id: i64,
    at: i64,
    notes: Vec<StepNote>,
) -> Result<bool, RecordsError> {
    let mut new = 0;
    for notes in notes.chunks(AT_ONCE) {
        let mut insert = query(AssertSqlSafe(format!(
            "INSERT INTO rollout_note (place, at, what) VALUES {} ON CONFLICT (place) DO NOTHING",
            values(notes.len(), 3)
        )));
        for note in notes {
            let robot = note.robot.as_ref().map_or("", RobotId::as_str);
            insert = insert
                .bind(format!("{id}/{robot}/{:010}", note.revision))
                .bind(at)
                .bind(&note.what);
        }
        new += insert.execute(connection).await?;
    }
    Ok(new > 0)
}

async fn write_parts(
    connection: &mut Connection<'_>,
    id: i64,
    step: RolloutStep,
) -> Result<(), RecordsError> {
    write_robots(connection, id, step.robots).await?;
    // An earlier call with the same step may have come to its end without an answer.
    if write_notes(connection, id, step.at, step.notes).await? {
        append_all(connection, &step.audit).await?;
    }
    Ok(())
}

async fn write(
    connection: &mut Connection<'_>,
    id: i64,
    epoch: u64,
    step: RolloutStep,
) -> Result<Written, RecordsError> {
    let there: Option<(i64,)> = query("SELECT epoch FROM rollout WHERE id = $1")
        .bind(id)
        .fetch_optional(&mut *connection)
        .await?;
    if there.is_none_or(|(there,)| there.cast_unsigned() != epoch) {
        return Ok(Written::Lost);
    }
    if let Some(document) = &step.document {
        query("UPDATE rollout SET document = $1, ended = $2 WHERE id = $3")
            .bind(document)
            .bind(step.over.then_some(step.at))
            .bind(id)
            .execute(&mut *connection)
            .await?;
    }
    write_parts(connection, id, step).await?;
    Ok(Written::Stored)
}

async fn add(connection: &mut Connection<'_>, new: NewRollout) -> Result<(), RecordsError> {
    let (all, at_work): (i64, i64) = query("SELECT count(*), count(*) - count(ended) FROM rollout")
        .fetch_one(&mut *connection)
        .await?;
    if at_work >= MAX_ROLLOUTS_AT_WORK {
        return Err(RecordsError::TooMany("rollouts at work"));
    }
    if all >= MAX_ROLLOUTS {
        forget_oldest(connection).await?;
    }
    let mut step = new.step;
    let document = step.document.take().unwrap_or_default();
    let done = query(
        "INSERT INTO rollout (id, made_by, made, ended, owner, epoch, beat, document)
         VALUES ($1, $2, $3, NULL, $4, 1, 0, $5) ON CONFLICT DO NOTHING",
    )
    .bind(new.id)
    .bind(cut(&new.by, MAX_BY))
    .bind(step.at)
    .bind(cut(&new.owner, MAX_OWNER))
    .bind(document)
    .execute(&mut *connection)
    .await?;
    crate::query::changed(done, RecordsError::Exists)?;
    if step.over {
        query("UPDATE rollout SET ended = made WHERE id = $1")
            .bind(new.id)
            .execute(&mut *connection)
            .await?;
    }
    write_parts(connection, new.id, step).await
}

async fn forget_oldest(connection: &mut Connection<'_>) -> Result<(), RecordsError> {
    let oldest: Option<(i64,)> =
        query("SELECT id FROM rollout WHERE ended IS NOT NULL ORDER BY id LIMIT 1")
            .fetch_optional(&mut *connection)
            .await?;
    let Some((id,)) = oldest else {
        return Err(RecordsError::TooMany("rollouts"));
    };
    let (from, to) = places(id);
    for sql in [
        "DELETE FROM rollout_robot WHERE place > $1 AND place < $2",
        "DELETE FROM rollout_note WHERE place > $1 AND place < $2",
    ] {
        query(sql)
            .bind(&from)
            .bind(&to)
            .execute(&mut *connection)
            .await?;
    }
    query("DELETE FROM rollout WHERE id = $1")
        .bind(id)
        .execute(connection)
        .await?;
    Ok(())
}

impl Rollouts<'_> {
    /// A number for a rollout that none had before.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn next_id(self) -> Result<i64, RecordsError> {
        // The newest one is never forgotten.
        let (newest,): (i64,) = self
            .0
            .read(|connection| {
                Box::pin(async move {
                    query("SELECT coalesce(max(id), 0) FROM rollout")
                        .fetch_one(connection)
                        .await
                })
            })
            .await?;
        Ok(newest.saturating_add(1))
    }

    /// Keeps a rollout that begins, with its first step.
    ///
    /// # Errors
    /// [`RecordsError::Exists`] when one has its number, [`RecordsError::TooMany`], or [`RecordsError::Invalid`] for
    /// what is too long.
    pub async fn add(self, new: NewRollout) -> Result<(), RecordsError> {
        new.step.check()?;
        if new.step.document.is_none() || new.owner.is_empty() {
            return Err(RecordsError::Invalid(
                "a rollout begins with a document, on a server",
            ));
        }
        self.0
            .write(move |connection| Box::pin(add(connection, new)))
            .await
    }

    /// Writes a step of a rollout, and returns once it is on disk. The same step may be written again: its notes
    /// and what the audit log says of them are there once.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written; nothing of it is then.
    pub async fn write(
        self,
        id: i64,
        epoch: u64,
        step: RolloutStep,
    ) -> Result<Written, RecordsError> {
        step.check()?;
        self.0
            .write(move |connection| Box::pin(write(connection, id, epoch, step)))
            .await
    }
}
