//! One file: one task that writes to it, in batches, and a few connections that read.

use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::time::Duration;

use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use sqlx::{ConnectOptions as _, Connection as _};
use tokio::sync::{mpsc, oneshot};

use crate::RecordsError;
use crate::schema::{self, Schema};

/// Writes that wait; who comes later waits for a place, and so is slowed down.
const QUEUE: usize = 256;
/// Writes that share a transaction, and so the wait for the disk.
const BATCH: usize = 128;
/// Connections that read.
const READERS: u32 = 4;
/// How long another process may hold the file before a write fails.
const BUSY: Duration = Duration::from_secs(5);
/// Length to which the write-ahead log is cut back.
const LOG_BYTES: &str = "67108864";

pub(crate) type Boxed<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;
/// Tells the caller what came of it, once the transaction is on disk or is not.
type Answer = Box<dyn FnOnce(Result<(), RecordsError>) + Send>;
/// Does the work, or tells the caller why it cannot be done. `None` when the caller knows already
/// that it failed.
type Work = Box<
    dyn for<'c> FnOnce(Result<&'c mut SqliteConnection, RecordsError>) -> Boxed<'c, Option<Answer>>
        + Send,
>;

enum Job {
    Write(Work),
    Close(oneshot::Sender<()>),
}

#[derive(Clone)]
pub(crate) struct Db {
    jobs: mpsc::Sender<Job>,
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
    /// not even a power cut takes back what was acknowledged.
    pub(crate) async fn open(
        path: &Path,
        schema: &Schema,
        safe: bool,
    ) -> Result<Self, RecordsError> {
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
    }

    /// The same without a file.
    pub(crate) async fn in_memory(schema: &Schema) -> Result<Self, RecordsError> {
        let path = Path::new(":memory:");
        let options = SqliteConnectOptions::new()
            .in_memory(true)
            .foreign_keys(true)
            .disable_statement_logging();
        let mut writer = SqliteConnection::connect_with(&options).await?;
        schema.migrate(&mut writer, path).await?;
        Ok(Self::start(writer, None, path))
    }

    fn start(writer: SqliteConnection, readers: Option<SqlitePool>, path: &Path) -> Self {
        let (jobs, queue) = mpsc::channel(QUEUE);
        tokio::spawn(write(writer, queue));
        Self {
            jobs,
            readers,
            path: path.to_owned(),
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is a file.
    pub(crate) fn on_disk(&self) -> bool {
        self.readers.is_some()
    }

    /// Carries out `work` in a transaction and returns when it is committed.
    ///
    /// A caller that stops waiting does not undo it: the work is done all the same.
    pub(crate) async fn write<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut SqliteConnection) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        let (sender, receiver) = oneshot::channel();
        let work: Work = Box::new(move |connection| {
            Box::pin(async move {
                let outcome = match connection {
                    Ok(connection) => work(connection).await,
                    Err(error) => Err(error),
                };
                match outcome {
                    Ok(value) => Some(Box::new(move |committed: Result<(), RecordsError>| {
                        // Nobody waits any more: nothing to tell.
                        let _ = sender.send(committed.map(|()| value));
                    }) as Answer),
                    Err(error) => {
                        let _ = sender.send(Err(error));
                        None
                    }
                }
            })
        });
        self.jobs
            .send(Job::Write(work))
            .await
            .map_err(|_| RecordsError::Closed)?;
        receiver.await.map_err(|_| RecordsError::Closed)?
    }

    /// Carries out `work`, which must not write.
    pub(crate) async fn read<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut SqliteConnection) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        let Some(readers) = &self.readers else {
            return self.write(work).await;
        };
        let mut reader = readers.acquire().await.map_err(|error| match error {
            sqlx::Error::PoolClosed => RecordsError::Closed,
            error => error.into(),
        })?;
        work(&mut reader).await
    }

    /// Lets the writer finish what waits and closes the file.
    pub(crate) async fn close(&self) {
        // Readers first: the last one to close brings the write-ahead log into the file, which
        // those who only read cannot.
        if let Some(readers) = &self.readers {
            readers.close().await;
        }
        let (done, closed) = oneshot::channel();
        if self.jobs.send(Job::Close(done)).await.is_ok() {
            // An error means that the writer is gone, which is what was asked for.
            let _ = closed.await;
        }
    }
}

/// The one writer. Ends when told to, or when nobody could ask it for anything any more.
async fn write(mut connection: SqliteConnection, mut queue: mpsc::Receiver<Job>) {
    let mut batch = Vec::with_capacity(BATCH);
    let mut closing = None;
    while closing.is_none() && queue.recv_many(&mut batch, BATCH).await > 0 {
        let mut work = Vec::with_capacity(batch.len());
        for job in batch.drain(..) {
            match job {
                Job::Write(job) => work.push(job),
                Job::Close(done) => closing = Some(done),
            }
        }
        if !work.is_empty() {
            transaction(&mut connection, work).await;
        }
    }
    // Closing copies the write-ahead log into the file; what fails here is done at the next start.
    if let Err(error) = connection.close().await {
        tracing::warn!(%error, "a file of records did not close cleanly");
    }
    if let Some(done) = closing {
        let _ = done.send(());
    }
}

/// Does `work` in one transaction. A piece that fails is undone alone; when the transaction itself
/// fails, all of it is, and every caller is told.
async fn transaction(connection: &mut SqliteConnection, work: Vec<Work>) {
    let mut answers = Vec::with_capacity(work.len());
    let mut trouble = run(connection, "BEGIN IMMEDIATE").await.err();
    for piece in work {
        trouble = match trouble {
            Some(error) => {
                piece(Err(error.clone())).await;
                Some(error)
            }
            None => one(connection, piece, &mut answers).await.err(),
        };
    }
    if trouble.is_none() {
        trouble = run(connection, "COMMIT").await.err();
    }
    if let Some(error) = &trouble {
        tracing::error!(%error, "a transaction failed");
        // Some errors have undone the transaction by themselves, and then this one says so.
        let _ = run(connection, "ROLLBACK").await;
    }
    let outcome = trouble.map_or(Ok(()), Err);
    for answer in answers {
        answer(outcome.clone());
    }
}

/// One piece. An error is one of the transaction, not of the piece.
async fn one(
    connection: &mut SqliteConnection,
    piece: Work,
    answers: &mut Vec<Answer>,
) -> Result<(), RecordsError> {
    if let Err(error) = run(connection, "SAVEPOINT piece").await {
        piece(Err(error.clone())).await;
        return Err(error);
    }
    match piece(Ok(&mut *connection)).await {
        Some(answer) => answers.push(answer),
        None => run(connection, "ROLLBACK TO piece").await?,
    }
    run(connection, "RELEASE piece").await
}

async fn run(connection: &mut SqliteConnection, sql: &'static str) -> Result<(), RecordsError> {
    sqlx::raw_sql(sql).execute(connection).await?;
    Ok(())
}

#[cfg(test)]
mod tests;
