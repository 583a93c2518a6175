//! One file: one task that writes to it, in batches, and a few connections that read.

use std::path::{Path, PathBuf};
use std::time::Duration;

use sqlx::pool::PoolConnection;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, Connection as _, Sqlite};

use crate::RecordsError;
use crate::queue::{self, Boxed, Queue, Transact as _, Waiting};
use crate::schema::{self, Schema};

/// Connections that read.
const READERS: u32 = 4;
/// How long another process may hold the file before a write fails.
const BUSY: Duration = Duration::from_secs(5);
/// Length to which the write-ahead log is cut back.
const LOG_BYTES: &str = "67108864";

/// One file. A clone is another handle of the same.
#[derive(Clone)]
pub struct Db {
    queue: Queue<SqliteConnection>,
    /// None in memory: there the writer's connection is the only one that sees the data.
    readers: Option<SqlitePool>,
    path: PathBuf,
}

impl std::fmt::Debug for Db {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Db").field(&self.path).finish()
    }
}

fn options(path: &Path, synchronous: SqliteSynchronous) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(synchronous)
        .busy_timeout(BUSY)
        .foreign_keys(true)
        .pragma("journal_size_limit", LOG_BYTES)
        // A file that somebody else made must not run code of theirs.
        .pragma("trusted_schema", "OFF")
        .disable_statement_logging()
}

impl Db {
    /// Opens or makes `path` and starts its writer. `safe` waits for the disk at each commit, so that
    /// not even a power cut takes back what was acknowledged. Must be called within a Tokio runtime.
    ///
    /// # Errors
    /// As of [`Schema::migrate`], or when the file cannot be made.
    pub fn open<'a>(
        path: &'a Path,
        schema: &'a Schema,
        safe: bool,
    ) -> Boxed<'a, Result<Self, RecordsError>> {
        Box::pin(async move {
            let synchronous = if safe {
                SqliteSynchronous::Full
            } else {
                SqliteSynchronous::Normal
            };
            crate::files::make_private(path)?;
            let options = options(path, synchronous);
            let mut writer = SqliteConnection::connect_with(&options)
                .await
                .map_err(|error| schema::unreadable(error, path))?;
            schema.migrate(&mut writer, path).await?;
            let readers = SqlitePoolOptions::new()
                .max_connections(READERS)
                .connect_lazy_with(options.read_only(true).create_if_missing(false));
            Ok(Self::start(writer, Some(readers), path))
        })
    }

    /// The same without a file.
    ///
    /// # Errors
    /// [`RecordsError`] when there is no memory for it.
    pub fn in_memory(schema: &Schema) -> Boxed<'_, Result<Self, RecordsError>> {
        Box::pin(async move {
            let path = Path::new(":memory:");
            let options = SqliteConnectOptions::new()
                .in_memory(true)
                .foreign_keys(true)
                .disable_statement_logging();
            let mut writer = SqliteConnection::connect_with(&options).await?;
            schema.migrate(&mut writer, path).await?;
            Ok(Self::start(writer, None, path))
        })
    }

    fn start(writer: SqliteConnection, readers: Option<SqlitePool>, path: &Path) -> Self {
        let (queue, waiting) = queue::queue();
        tokio::spawn(write(writer, waiting));
        Self {
            queue,
            readers,
            path: path.to_owned(),
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is a file.
    pub fn on_disk(&self) -> bool {
        self.readers.is_some()
    }

    /// Carries out `work` in a transaction and returns when it is committed.
    ///
    /// A caller that stops waiting does not undo it: the work is done all the same.
    ///
    /// # Errors
    /// Those of `work`, and why it was not carried out or committed.
    pub async fn write<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut SqliteConnection) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        self.queue.write(work).await
    }

    /// Carries out `work`, which must not write.
    ///
    /// # Errors
    /// Those of `work`, and why it was not carried out.
    pub async fn read<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut SqliteConnection) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        let Some(readers) = &self.readers else {
            return self.write(work).await;
        };
        let mut reader = reader(readers).await?;
        work(&mut reader).await
    }

    /// Lets the writer finish what waits and closes the file.
    pub fn close(&self) -> Boxed<'_, ()> {
        Box::pin(async move {
            // Readers first: the last one to close brings the write-ahead log into the file, which
            // those who only read cannot.
            if let Some(readers) = &self.readers {
                readers.close().await;
            }
            self.queue.close().await;
        })
    }
}

fn reader(readers: &SqlitePool) -> Boxed<'_, Result<PoolConnection<Sqlite>, RecordsError>> {
    Box::pin(async move {
        readers.acquire().await.map_err(|error| match error {
            sqlx::Error::PoolClosed => RecordsError::Closed,
            error => error.into(),
        })
    })
}

async fn write(mut connection: SqliteConnection, mut waiting: Waiting<SqliteConnection>) {
    while let Some(work) = waiting.next().await {
        let outcome = match connection.run("BEGIN IMMEDIATE").await {
            Ok(()) => queue::carry_out(&mut connection, work, None).await,
            Err(error) => {
                queue::refuse(work, &error).await;
                Err(error)
            }
        };
        if let Err(error) = outcome {
            tracing::error!(%error, "a transaction failed");
            // Some errors have undone the transaction by themselves, and then this one says so.
            let _ = connection.run("ROLLBACK").await;
        }
    }
    // Closing copies the write-ahead log into the file; what fails here is done at the next start.
    if let Err(error) = connection.close().await {
        tracing::warn!(%error, "a file of records did not close cleanly");
    }
    waiting.closed();
}

#[cfg(test)]
mod tests;
