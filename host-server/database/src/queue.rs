//! Writes wait in line for the one task that carries them out, which puts what waits into one
//! transaction.

use std::pin::Pin;

use sqlx::postgres::PgConnection;
use sqlx::sqlite::SqliteConnection;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

use crate::RecordsError;

/// Writes that wait; who comes later waits for a place, and so is slowed down.
const QUEUE: usize = 256;
/// Writes that share a transaction, and so the wait for the disk.
const BATCH: usize = 128;

/// What a function gives that is not `async` itself: the body of one that is, is compiled in each crate that
/// awaits it, and with it all of sqlx that it calls. Behind a pointer both are compiled here, once.
pub type Boxed<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;
/// Tells the caller what came of it, once the transaction is on disk or is not.
type Answer = Box<dyn FnOnce(Result<(), RecordsError>) + Send>;
/// Does the work, or tells the caller why it cannot be done. `None` when the caller knows already
/// that it failed.
pub type Work<C> =
    Box<dyn for<'c> FnOnce(Result<&'c mut C, RecordsError>) -> Boxed<'c, Option<Answer>> + Send>;

enum Job<C> {
    Write(Work<C>),
    Close(oneshot::Sender<()>),
}

/// A connection on which work is carried out.
pub trait Transact: Send {
    /// Carries out statements without values.
    ///
    /// # Errors
    /// What the database says against one of them.
    fn run(&mut self, sql: &'static str) -> Boxed<'_, Result<(), RecordsError>>;
}

impl Transact for SqliteConnection {
    fn run(&mut self, sql: &'static str) -> Boxed<'_, Result<(), RecordsError>> {
        Box::pin(async move {
            sqlx::raw_sql(sql).execute(self).await?;
            Ok(())
        })
    }
}

impl Transact for PgConnection {
    fn run(&mut self, sql: &'static str) -> Boxed<'_, Result<(), RecordsError>> {
        Box::pin(async move {
            sqlx::raw_sql(sql).execute(self).await?;
            Ok(())
        })
    }
}

/// Where writers stand in line.
pub struct Queue<C>(mpsc::Sender<Job<C>>);

impl<C> Clone for Queue<C> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

/// The other end of it.
pub struct Waiting<C> {
    jobs: mpsc::Receiver<Job<C>>,
    closing: Option<oneshot::Sender<()>>,
}

/// Both ends of a queue.
#[must_use]
pub fn queue<C>() -> (Queue<C>, Waiting<C>) {
    let (sender, jobs) = mpsc::channel(QUEUE);
    let closing = None;
    (Queue(sender), Waiting { jobs, closing })
}

impl<C: 'static> Queue<C> {
    /// Has `work` carried out in a transaction and returns when it is committed.
    ///
    /// A caller that stops waiting does not undo it: the work is done all the same.
    ///
    /// # Errors
    /// Those of `work`, and why it was not carried out or committed.
    pub async fn write<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut C) -> Boxed<'c, Result<T, RecordsError>> + Send + 'static,
        C: Send,
    {
        let (sender, receiver) = oneshot::channel();
        let work: Work<C> = Box::new(move |connection| {
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
        self.0
            .send(Job::Write(work))
            .await
            .map_err(|_| RecordsError::Closed)?;
        // Given up in the middle, or nobody is there any more.
        receiver.await.map_err(|_| {
            if self.0.is_closed() {
                RecordsError::Closed
            } else {
                RecordsError::late()
            }
        })?
    }

    /// How many wait.
    pub fn waiting(&self) -> usize {
        self.0.max_capacity() - self.0.capacity()
    }

    /// Returns when what waits is done and the writer has ended.
    pub async fn close(&self) {
        let (done, closed) = oneshot::channel();
        if self.0.send(Job::Close(done)).await.is_ok() {
            // An error means that the writer is gone, which is what was asked for.
            let _ = closed.await;
        }
    }
}

impl<C> Waiting<C> {
    /// What waits, as much as fits into a transaction. `None` when the writer is to end: it was told
    /// to, or nobody could ask it for anything any more.
    pub async fn next(&mut self) -> Option<Vec<Work<C>>> {
        let mut batch = Vec::with_capacity(BATCH);
        while self.closing.is_none() && self.jobs.recv_many(&mut batch, BATCH).await > 0 {
            let mut work = Vec::with_capacity(batch.len());
            for job in batch.drain(..) {
                match job {
                    Job::Write(job) => work.push(job),
                    Job::Close(done) => self.closing = Some(done),
                }
            }
            if !work.is_empty() {
                return Some(work);
            }
        }
        None
    }

    /// Says that everything is done.
    pub fn closed(self) {
        if let Some(done) = self.closing {
            let _ = done.send(());
        }
    }
}

/// Tells everybody that it cannot be done.
pub async fn refuse<C>(work: Vec<Work<C>>, error: &RecordsError) {
    for piece in work {
        piece(Err(error.clone())).await;
    }
}

/// Does `work` in the transaction that has begun. A piece that fails is undone alone; when the
/// transaction itself fails, or `until` passes, all of it is, and every caller is told.
///
/// # Errors
/// Of the transaction, not of a piece.
pub async fn carry_out<C: Transact>(
    connection: &mut C,
    work: Vec<Work<C>>,
    until: Option<Instant>,
) -> Result<(), RecordsError> {
    let mut answers = Vec::with_capacity(work.len());
    let mut trouble: Option<RecordsError> = None;
    for piece in work {
        trouble = match trouble {
            Some(error) => {
                piece(Err(error.clone())).await;
                Some(error)
            }
            None => one(connection, piece, &mut answers, until).await.err(),
        };
    }
    if trouble.is_none() {
        trouble = within(until, connection.run("COMMIT")).await.err();
    }
    let outcome = trouble.map_or(Ok(()), Err);
    for answer in answers {
        answer(outcome.clone());
    }
    outcome
}

/// One piece. An error is one of the transaction, not of the piece.
async fn one<C: Transact>(
    connection: &mut C,
    piece: Work<C>,
    answers: &mut Vec<Answer>,
    until: Option<Instant>,
) -> Result<(), RecordsError> {
    if let Err(error) = within(until, connection.run("SAVEPOINT piece")).await {
        piece(Err(error.clone())).await;
        return Err(error);
    }
    match within(until, async { Ok(piece(Ok(&mut *connection)).await) }).await? {
        Some(answer) => answers.push(answer),
        None => within(until, connection.run("ROLLBACK TO piece")).await?,
    }
    within(until, connection.run("RELEASE piece")).await
}

/// What comes of `work`, unless `until` passes first.
///
/// # Errors
/// Those of `work`, or [`RecordsError::Unavailable`].
pub async fn within<T>(
    until: Option<Instant>,
    work: impl Future<Output = Result<T, RecordsError>>,
) -> Result<T, RecordsError> {
    match until {
        Some(until) => tokio::time::timeout_at(until, work)
            .await
            .unwrap_or_else(|_| Err(RecordsError::late())),
        None => work.await,
    }
}
