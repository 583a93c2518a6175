//! The tables, and how a file gets from one version of them to the next.

use std::path::Path;

use sqlx::{Connection as _, SqliteConnection};

use crate::RecordsError;

/// The tables of one file.
#[derive(Debug, Clone, Copy)]
pub struct Schema {
    /// Marks the file as ours, in its header (`PRAGMA application_id`).
    pub id: i64,
    /// `steps[n]` leads from version n to n + 1. A step that was released is never edited.
    pub steps: &'static [&'static str],
}

impl Schema {
    /// The version that this program writes.
    pub fn version(&self) -> i64 {
        self.steps.len() as i64
    }

    /// Whether `file` is ours, whole enough to be read, and not from a newer program. Returns its
    /// version; 0 is an empty file.
    ///
    /// # Errors
    /// [`RecordsError::Foreign`], [`RecordsError::Newer`], [`RecordsError::Damaged`], or what else keeps it
    /// from being read.
    pub async fn check(
        &self,
        connection: &mut SqliteConnection,
        file: &Path,
    ) -> Result<i64, RecordsError> {
        let (id,): (i64,) = sqlx::query_as("PRAGMA application_id")
            .fetch_one(&mut *connection)
            .await
            .map_err(|error| unreadable(error, file))?;
        let (version,): (i64,) = sqlx::query_as("PRAGMA user_version")
            .fetch_one(&mut *connection)
            .await
            .map_err(|error| unreadable(error, file))?;
        let (tables,): (i64,) = sqlx::query_as("SELECT count(*) FROM sqlite_schema")
            .fetch_one(&mut *connection)
            .await
            .map_err(|error| unreadable(error, file))?;
        let empty = id == 0 && version == 0 && tables == 0;
        if id != self.id && !empty {
            return Err(RecordsError::Foreign(file.to_owned()));
        }
        if version > self.version() {
            return Err(RecordsError::Newer {
                file: file.to_owned(),
                found: version,
                known: self.version(),
            });
        }
        Ok(version)
    }

    /// Brings `file` to the newest version. Each step is one transaction: a crash between two of
    /// them leaves a file that the next start goes on with.
    ///
    /// # Errors
    /// As of [`Schema::check`], and when it cannot be written.
    pub async fn migrate(
        &self,
        connection: &mut SqliteConnection,
        file: &Path,
    ) -> Result<(), RecordsError> {
        self.check(connection, file).await?;
        for step in 1..=self.version() {
            let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
            // Asked anew inside: another process may have just made the step.
            let (version,): (i64,) = sqlx::query_as("PRAGMA user_version")
                .fetch_one(&mut *transaction)
                .await?;
            if version < step {
                let sql = self.steps[step as usize - 1];
                sqlx::raw_sql(sql).execute(&mut *transaction).await?;
                // A pragma takes no parameters; both values are numbers of this program.
                let marks = format!(
                    "PRAGMA application_id = {}; PRAGMA user_version = {step}",
                    self.id
                );
                sqlx::raw_sql(sqlx::AssertSqlSafe(marks))
                    .execute(&mut *transaction)
                    .await?;
            }
            transaction.commit().await?;
        }
        Ok(())
    }
}

/// An error of the first read: a file that is none of `SQLite`'s, or a damaged one, says so here.
#[must_use]
pub fn unreadable(error: sqlx::Error, file: &Path) -> RecordsError {
    const CORRUPT: i32 = 11;
    const NOT_A_DATABASE: i32 = 26;
    let text = error.to_string();
    let error = RecordsError::from(error);
    match error.sqlite_code() {
        Some(CORRUPT | NOT_A_DATABASE) => RecordsError::damaged(file, text),
        _ => error,
    }
}

/// Whether the pages of `file` fit together.
///
/// # Errors
/// [`RecordsError::Damaged`] when they do not.
pub async fn check_whole(
    connection: &mut SqliteConnection,
    file: &Path,
) -> Result<(), RecordsError> {
    let (answer,): (String,) = sqlx::query_as("PRAGMA quick_check(1)")
        .fetch_one(connection)
        .await
        .map_err(|error| unreadable(error, file))?;
    if answer == "ok" {
        Ok(())
    } else {
        Err(RecordsError::damaged(file, answer))
    }
}
