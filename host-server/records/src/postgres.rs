//! A database that several servers share: one task that writes to it, in batches, and a few
//! connections that read.
//!
//! Every wait is bounded, here and in the database. A connection that breaks is made anew by the next
//! call; what was under way fails with [`RecordsError::Unavailable`].

mod address;
mod health;
pub(crate) mod schema;

use std::sync::Arc;
use std::time::Duration;

use sqlx::pool::PoolConnection;
use sqlx::postgres::{PgConnectOptions, PgConnection, PgPool, PgPoolOptions};
use sqlx::{ConnectOptions as _, Connection as _, Postgres};
use tokio::time::Instant;

use crate::RecordsError;
use crate::query::{Connection, query};
use crawler_database::{
    Boxed, PATIENCE, Queue, Transact as _, Waiting, carry_out, queue, refuse, within,
};

use health::Health;

pub use health::DatabaseStats;

/// For saying goodbye to a database that may be gone.
const GOODBYE: Duration = Duration::from_secs(1);
/// Connections that read.
const READERS: u32 = 4;
/// A transaction that changes something is alone: writers of all servers take turns, as they do at a
/// file. So what is read in it still holds when it ends, and the audit log is one chain. The first
/// number is that of our files, so that other programs in the same database use others.
const BEGIN: &str = "BEGIN; SELECT pg_advisory_xact_lock(1413698162, 1)";
/// Held by everyone who has the database open, and alone by who replaces what is in it.
const OPEN_SHARED: &str = "SELECT pg_try_advisory_lock_shared(1413698162, 2)";
const OPEN_ALONE: &str = "SELECT pg_try_advisory_lock(1413698162, 2)";
const LEAVE_ALONE: &str = "SELECT pg_advisory_unlock(1413698162, 2)";
/// An answer must mean that it is on disk, whatever the database's own default is.
const DURABLE: &str = "SELECT set_config('synchronous_commit', 'on', false)
    WHERE current_setting('synchronous_commit') = 'off'";

/// Who else may have the database open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Share {
    Others,
    Nobody,
}

/// A database somewhere.
#[derive(Clone)]
pub(crate) struct Remote {
    queue: Queue<PgConnection>,
    readers: PgPool,
    place: Arc<Place>,
    health: Arc<Health>,
}

/// Where it is.
struct Place {
    options: PgConnectOptions,
    /// Without user name and password.
    shown: String,
}

impl std::fmt::Debug for Remote {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Remote").field(&self.place.shown).finish()
    }
}

impl Remote {
    /// Opens the database at `url` and starts its writer. An empty one gets its tables if `make` says
    /// so, and is [`RecordsError::NotFound`] otherwise.
    pub(crate) fn open(url: &str, make: bool) -> Boxed<'_, Result<Self, RecordsError>> {
        Box::pin(Self::connect(url, make))
    }

    async fn connect(url: &str, make: bool) -> Result<Self, RecordsError> {
        let place = Arc::new(Place::new(url)?);
        let until = Some(Instant::now() + PATIENCE);
        let mut connection = place.connect(Share::Others, until).await?;
        within(until, async {
            if schema::check(&mut connection, &place.shown).await? == 0 && !make {
                return Err(RecordsError::NotFound);
            }
            connection.run(BEGIN).await?;
            schema::migrate(&mut connection, &place.shown)
                .await
                .map_err(|error| place.explain(error))?;
            connection.run("COMMIT").await
        })
        .await?;
        let readers = PgPoolOptions::new()
            .max_connections(READERS)
            .acquire_timeout(PATIENCE)
            .connect_lazy_with(place.options.clone());
        let (queue, waiting) = queue();
        let health = Arc::new(Health::default());
        let writer = Writer {
            place: place.clone(),
            health: health.clone(),
            connection: Some(connection),
        };
        tokio::spawn(writer.run(waiting));
        Ok(Self {
            queue,
            readers,
            place,
            health,
        })
    }

    pub(crate) fn stats(&self) -> DatabaseStats {
        self.health.stats(self.queue.waiting() as u64)
    }

    /// As [`crate::store::Store::write`].
    pub(crate) async fn write<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut PgConnection) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        self.health.refused()?;
        within(Some(Instant::now() + PATIENCE), self.queue.write(work)).await
    }

    /// As [`crate::store::Store::read`].
    pub(crate) async fn read<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut PgConnection) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        self.health.refused()?;
        let until = Some(Instant::now() + PATIENCE);
        let acquired = within(until, self.reader()).await;
        let mut reader = match acquired {
            Ok(reader) => reader,
            Err(error) => return Err(self.health.unreachable(self.place.explain(error))),
        };
        let outcome = within(until, work(&mut reader)).await;
        if outcome.as_ref().is_err_and(RecordsError::is_passing) {
            // In the middle of something, perhaps.
            reader.close_on_drop();
        }
        self.health.note(&outcome);
        outcome
    }

    fn reader(&self) -> Boxed<'_, Result<PoolConnection<Postgres>, RecordsError>> {
        Box::pin(async move { Ok(self.readers.acquire().await?) })
    }

    /// A connection of its own, for what takes long: it waits for as long as that takes.
    pub(crate) fn patient(&self) -> Boxed<'_, Result<PgConnection, RecordsError>> {
        Box::pin(self.place.patient(Share::Others))
    }

    pub(crate) fn close(&self) -> Boxed<'_, ()> {
        Box::pin(async move {
            let readers = within(Some(Instant::now() + PATIENCE), async {
                self.readers.close().await;
                Ok(())
            });
            if readers.await.is_err() {
                tracing::warn!("a read of the database does not end and is left behind");
            }
            self.queue.close().await;
        })
    }
}

impl Place {
    fn new(url: &str) -> Result<Self, RecordsError> {
        let options = address::options(url)?;
        let milliseconds = PATIENCE.as_millis();
        let options = options.disable_statement_logging().options([
            ("statement_timeout", milliseconds),
            ("lock_timeout", milliseconds),
            // A server that hangs must not keep the others from writing.
            ("idle_in_transaction_session_timeout", milliseconds),
        ]);
        let shown = address::shown(&options);
        Ok(Self { options, shown })
    }

    /// A connection to a database that this program can use.
    async fn connect(
        &self,
        share: Share,
        until: Option<Instant>,
    ) -> Result<PgConnection, RecordsError> {
        let connected = async {
            let connected = PgConnection::connect_with(&self.options).await;
            connected.map_err(|error| address::tls(error).into())
        };
        let mut connection = within(until, connected)
            .await
            .map_err(|error| self.explain(error))?;
        within(until, async {
            let sql = match share {
                Share::Others => OPEN_SHARED,
                Share::Nobody => OPEN_ALONE,
            };
            let lent = &mut Connection::Postgres(&mut connection);
            let (open,): (bool,) = query(sql).fetch_one(lent).await?;
            if !open {
                return Err(RecordsError::InUse(self.shown.clone().into()));
            }
            let _: Option<(String,)> = query(DURABLE).fetch_optional(lent).await?;
            Ok(())
        })
        .await?;
        Ok(connection)
    }

    /// The same, without limits from then on.
    async fn patient(&self, share: Share) -> Result<PgConnection, RecordsError> {
        let mut connection = self.connect(share, Some(Instant::now() + PATIENCE)).await?;
        connection
            .run(
                "SET statement_timeout = 0; SET lock_timeout = 0;
                 SET idle_in_transaction_session_timeout = 0",
            )
            .await?;
        schema::check(&mut connection, &self.shown).await?;
        Ok(connection)
    }

    /// Says where, and what to do.
    fn explain(&self, error: RecordsError) -> RecordsError {
        address::explain(error, &self.options, &self.shown)
    }
}

/// A connection that nobody shares, in a transaction, to replace what is in the database.
pub(crate) fn alone(url: &str) -> Boxed<'_, Result<PgConnection, RecordsError>> {
    Box::pin(async move {
        let place = Place::new(url)?;
        let mut connection = place.patient(Share::Nobody).await?;
        connection.run(BEGIN).await?;
        schema::migrate(&mut connection, &place.shown)
            .await
            .map_err(|error| place.explain(error))?;
        Ok(connection)
    })
}

/// Ends a connection that nobody shares. Whoever comes next finds the database free: by itself it notices only
/// a moment later that a connection has ended.
pub(crate) fn leave(mut connection: PgConnection) -> Boxed<'static, ()> {
    Box::pin(async move {
        let goodbye = async move {
            connection.run(LEAVE_ALONE).await?;
            Ok::<_, RecordsError>(connection.close().await?)
        };
        // Everything is done; what has broken since is let go by the database.
        let _ = tokio::time::timeout(GOODBYE, goodbye).await;
    })
}

/// The one that writes, of this process.
struct Writer {
    place: Arc<Place>,
    health: Arc<Health>,
    connection: Option<PgConnection>,
}

impl Writer {
    async fn run(mut self, mut waiting: Waiting<PgConnection>) {
        while let Some(work) = waiting.next().await {
            let began = Instant::now();
            let until = began + PATIENCE;
            let outcome = match self.begin(until).await {
                Ok(mut connection) => {
                    let outcome = carry_out(&mut connection, work, Some(until)).await;
                    // After trouble nobody knows where it stands. Without it, the database undoes
                    // what was under way.
                    self.connection = outcome.is_ok().then_some(connection);
                    outcome
                }
                Err(error) => {
                    refuse(work, &error).await;
                    Err(error)
                }
            };
            if let Err(error) = &outcome {
                tracing::error!(%error, "a transaction failed");
            }
            self.health.transaction(&outcome, began.elapsed());
        }
        if let Some(connection) = self.connection {
            // A database that is gone has let go by itself.
            let _ = tokio::time::timeout(GOODBYE, connection.close()).await;
        }
        waiting.closed();
    }

    /// A connection in whose transaction work can be done.
    async fn begin(&mut self, until: Instant) -> Result<PgConnection, RecordsError> {
        let soon = until - PATIENCE / 2;
        let until = Some(until);
        if let Some(mut connection) = self.connection.take() {
            match within(until, connection.run(BEGIN)).await {
                Ok(()) => return Ok(connection),
                // Cut off while nobody used it, it says so at once: nothing is lost by another one.
                Err(error) if error.is_passing() && Instant::now() < soon => {}
                Err(error) => return Err(error),
            }
        }
        let connected = self.place.connect(Share::Others, until).await;
        let mut connection = connected.map_err(|error| self.health.unreachable(error))?;
        within(until, async {
            if schema::check(&mut connection, &self.place.shown).await? == 0 {
                return Err(RecordsError::Foreign(self.place.shown.clone().into()));
            }
            connection.run(BEGIN).await
        })
        .await?;
        tracing::info!(database = %self.place.shown, "connected to the database again");
        Ok(connection)
    }
}
