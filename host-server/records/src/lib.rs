//! What a server must not forget: accounts, credentials, audit log, experiments, fences, events, releases, rollouts,
//! history.
//!
//! [`Records::open`] opens a directory with two files. `records.sqlite` holds settings, [`User`]s,
//! [`Invitation`]s, [`Session`]s, [`Credential`]s, [`Experiment`]s, releases ([`KeptRelease`]), rollouts
//! ([`KeptRollout`]), fences ([`KeptFence`]), [`Event`]s and the audit log of [`Entry`]s: a call that changes it
//! returns when the change is on disk, also against a power cut. `history.sqlite` holds the [`History`]: samples
//! are taken in by the thousand and reach the disk
//! within half a second.
//!
//! [`Records::connect`] has the first of the two in a `PostgreSQL` database instead, which several
//! servers may share.
//!
//! Each is written by one task, which puts what waits into one transaction; reads go
//! past it. Several processes may open the same directory: what they write to the records is in
//! one order, and the audit log stays one chain. History is kept by the first of them.
//!
//! Times are Unix milliseconds and handed in. Only the history looks at a clock, for what it may
//! forget.
//!
//! [`Records`] owns the database and says what concerns all of it. Each table, or few that are one idea, has
//! a handle: [`Records::users`] lends [`Users`], whose calls read and write accounts and nothing else. A handle is a
//! reference, so whoever needs one table can ask for that and no more. All fail with a [`RecordsError`]; each call says
//! with which of them.
//!
//! Reading order: `store`, which is behind every handle, and `settings`, the smallest of them; for people and machines
//! `account`, `users`, `invitations`, `sessions` and `credentials`; `audit`, which [`audit_log`] fills for those who cannot
//! wait; `events`, `arenas` and `fences`; `experiments` (the experiments, their trials, the parts that are left to
//! do), `releases` and `rollouts`; below them `schema`, `query`, `postgres` and `text`; [`backup`] and `transfer`.

mod account;
mod arenas;
mod audit;
pub mod audit_log;
pub mod backup;
mod credentials;
mod events;
mod experiments;
mod fences;
mod invitations;
mod postgres;
mod query;
mod releases;
mod rollouts;
mod schema;
mod sessions;
mod settings;
mod store;
mod text;
mod transfer;
mod users;

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use crawler_database::{Boxed, Db, Hold, Lock, beside, check_whole};
use crawler_history::{HISTORY_FILE, History, Running};

pub use crawler_database::RecordsError;

pub use account::User;
pub use arenas::{Arenas, MAX_ARENA};
pub use audit::{Audit, Broken, Entry, MAX_AUDIT_PAGE, Stored};
pub use credentials::{Credential, Credentials, MAX_CREDENTIAL_NAME, MAX_CREDENTIALS};
pub use events::{
    Event, EventCursor, EventLevel, EventQuery, EventRetention, Events, MAX_EVENT_TEXT,
    MAX_EVENTS_PAGE, NoCursor, StoredEvent,
};
pub use experiments::{
    Experiment, ExperimentKind, ExperimentParts, ExperimentState, Experiments, Holder,
    MAX_EXPERIMENT_TEXT, MAX_EXPERIMENTS, MAX_LOST, MAX_SEEDS, MAX_TRAININGS, MAX_TRIALS,
    MAX_WORKER, NewExperiment, NewTrials, Part, RunningExperiment, StoredTrial, Trials, part_size,
};
pub use fences::{Fences, KeptFence, MAX_FENCE_NAME, MAX_FENCES};
pub use invitations::{Invitation, Invitations, MAX_INVITATIONS};
pub use postgres::DatabaseStats;
pub use releases::{
    KeptRelease, MAX_RELEASE_BYTES, MAX_RELEASE_GATE, MAX_RELEASE_REASON, MAX_RELEASES, NewRelease,
    RELEASE_PIECE, Releases, Withdrawal,
};
pub use rollouts::{
    KeptRollout, Lease, MAX_ROLLOUT_DOCUMENT, MAX_ROLLOUT_ENTRY, MAX_ROLLOUT_PAGE, MAX_ROLLOUTS,
    MAX_ROLLOUTS_AT_WORK, NewRollout, RolloutRobot, RolloutStep, Rollouts, StepNote, Taken,
    Written,
};
pub use sessions::{MAX_FROM, MAX_SESSIONS, Refreshed, Session, Sessions};
pub use settings::{MAX_SETTING, MAX_SETTING_KEY, Settings};
pub use users::{MAX_PASSWORD_HASH, MAX_USERS, Users};

use postgres::Remote;
use query::{Connection, query};
use store::Store;

/// File of accounts, credentials and the audit log, in the data directory.
pub const RECORDS_FILE: &str = "records.sqlite";
/// Held by everyone who has the directory open, and alone by who replaces its files.
const LOCK_FILE: &str = "records.lock";

/// The records of a server. A clone is another handle of the same.
#[derive(Debug, Clone)]
pub struct Records(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    db: Store,
    history: History,
    /// None when another process keeps the history, and once it was closed.
    keeper: Mutex<Option<Running>>,
    /// None in memory.
    _lock: Option<Lock>,
}

impl Records {
    /// Opens the records in `dir`, which is made if it is not there. Must be called within a Tokio
    /// runtime.
    ///
    /// # Errors
    /// [`RecordsError::Damaged`], [`RecordsError::Newer`] and [`RecordsError::Foreign`] say what is
    /// wrong with the file; it is left as it is. [`RecordsError::InUse`] while a backup is restored.
    pub async fn open(dir: &Path) -> Result<Self, RecordsError> {
        Self::open_with(dir, true).await
    }

    /// Like [`Records::open`] for a server whose history is elsewhere: no file of it is made or
    /// looked at, and [`Records::history`] takes no samples.
    ///
    /// # Errors
    /// As for [`Records::open`].
    pub async fn open_without_history(dir: &Path) -> Result<Self, RecordsError> {
        Self::open_with(dir, false).await
    }

    fn open_with(dir: &Path, history: bool) -> Boxed<'_, Result<Self, RecordsError>> {
        Box::pin(async move {
            std::fs::create_dir_all(dir).map_err(|error| RecordsError::io(dir, error))?;
            let lock = Lock::take(&dir.join(LOCK_FILE), Hold::Shared)?
                .ok_or_else(|| RecordsError::InUse(dir.to_owned()))?;
            let path = dir.join(RECORDS_FILE);
            not_emptied(&path, &dir.join(HISTORY_FILE))?;
            let db = Db::open(&path, &schema::RECORDS, true).await?;
            let file = path.clone();
            let whole = db
                .read(move |connection| {
                    Box::pin(async move { check_whole(connection, &file).await })
                })
                .await;
            let opened = match whole {
                Ok(()) if history => History::open(dir).await,
                Ok(()) => Ok(History::none()),
                Err(error) => Err(error),
            };
            match opened {
                Ok(history) => Ok(Self::of(Store::Sqlite(db), history, Some(lock))),
                Err(error) => {
                    db.close().await;
                    Err(error)
                }
            }
        })
    }

    /// Records that are gone with the last handle, for tests and for a server without a data
    /// directory.
    ///
    /// # Errors
    /// [`RecordsError`] when there is no memory for it.
    pub async fn in_memory() -> Result<Self, RecordsError> {
        Self::open_in_memory().await
    }

    fn open_in_memory() -> Boxed<'static, Result<Self, RecordsError>> {
        Box::pin(async move {
            let db = Db::in_memory(&schema::RECORDS).await?;
            let history = History::in_memory().await?;
            Ok(Self::of(Store::Sqlite(db), history, None))
        })
    }

    /// Opens the records in the `PostgreSQL` database at `url`, which gets its tables if it is empty
    /// and `make` says so. The history is in the directory `history`; without one, it takes no samples.
    /// Must be called within a Tokio runtime.
    ///
    /// Every call returns within about five seconds, whatever the database does; one that cannot be
    /// reached is connected to again by the calls that follow.
    ///
    /// # Errors
    /// [`RecordsError::Unavailable`] and [`RecordsError::Refused`] when the database does not answer
    /// or lets nobody in, [`RecordsError::NotFound`] when it is empty and is to stay so,
    /// [`RecordsError::Damaged`], [`RecordsError::Newer`] and [`RecordsError::Foreign`] for what it
    /// holds, [`RecordsError::InUse`] while a backup is restored, and those of the history.
    pub async fn connect(
        url: &str,
        history: Option<&Path>,
        make: bool,
    ) -> Result<Self, RecordsError> {
        Self::open_database(url, history, make).await
    }

    fn open_database<'a>(
        url: &'a str,
        history: Option<&'a Path>,
        make: bool,
    ) -> Boxed<'a, Result<Self, RecordsError>> {
        Box::pin(async move {
            let lock = match history {
                Some(dir) => {
                    std::fs::create_dir_all(dir).map_err(|error| RecordsError::io(dir, error))?;
                    let lock = Lock::take(&dir.join(LOCK_FILE), Hold::Shared)?;
                    Some(lock.ok_or_else(|| RecordsError::InUse(dir.to_owned()))?)
                }
                None => None,
            };
            let remote = Remote::open(url, make).await?;
            let opened = match history {
                Some(dir) => History::open(dir).await,
                None => Ok(History::none()),
            };
            match opened {
                Ok(history) => Ok(Self::of(Store::Postgres(remote), history, lock)),
                Err(error) => {
                    remote.close().await;
                    Err(error)
                }
            }
        })
    }

    /// How the database is doing; `None` when the records are in a file.
    pub fn database(&self) -> Option<DatabaseStats> {
        match self.db() {
            Store::Sqlite(_) => None,
            Store::Postgres(remote) => Some(remote.stats()),
        }
    }

    fn of(db: Store, history: (History, Option<Running>), lock: Option<Lock>) -> Self {
        let (history, keeper) = history;
        Self(Arc::new(Inner {
            db,
            history,
            keeper: Mutex::new(keeper),
            _lock: lock,
        }))
    }

    /// What the robots measured.
    pub fn history(&self) -> &History {
        &self.0.history
    }

    /// Values of no kind of their own, by key.
    #[must_use]
    pub fn settings(&self) -> Settings<'_> {
        Settings(self.db())
    }

    /// The accounts of people.
    #[must_use]
    pub fn users(&self) -> Users<'_> {
        Users(self.db())
    }

    /// Who may make an account, or complete one.
    #[must_use]
    pub fn invitations(&self) -> Invitations<'_> {
        Invitations(self.db())
    }

    /// Who is logged in.
    #[must_use]
    pub fn sessions(&self) -> Sessions<'_> {
        Sessions(self.db())
    }

    /// What robots and simulators log in with.
    #[must_use]
    pub fn credentials(&self) -> Credentials<'_> {
        Credentials(self.db())
    }

    /// Who did what.
    #[must_use]
    pub fn audit(&self) -> Audit<'_> {
        Audit(self.db())
    }

    /// What an operator should know of.
    #[must_use]
    pub fn events(&self) -> Events<'_> {
        Events(self.db())
    }

    /// What the simulated arena was, by time.
    #[must_use]
    pub fn arenas(&self) -> Arenas<'_> {
        Arenas(self.db())
    }

    /// The fences.
    #[must_use]
    pub fn fences(&self) -> Fences<'_> {
        Fences(self.db())
    }

    /// The experiments.
    #[must_use]
    pub fn experiments(&self) -> Experiments<'_> {
        Experiments(self.db())
    }

    /// What the trials of experiments measured.
    #[must_use]
    pub fn trials(&self) -> Trials<'_> {
        Trials(self.db())
    }

    /// What is left to do of experiments, and who does it.
    #[must_use]
    pub fn parts(&self) -> ExperimentParts<'_> {
        ExperimentParts(self.db())
    }

    /// The releases.
    #[must_use]
    pub fn releases(&self) -> Releases<'_> {
        Releases(self.db())
    }

    /// The rollouts.
    #[must_use]
    pub fn rollouts(&self) -> Rollouts<'_> {
        Rollouts(self.db())
    }

    /// Finishes what waits to be written and closes the files. Calls fail from then on.
    pub async fn close(&self) {
        let keeper = self
            .0
            .keeper
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(keeper) = keeper {
            keeper.end().await;
        }
        if let Some(history) = self.0.history.db() {
            history.close().await;
        }
        self.0.db.close().await;
    }

    /// Forgets what is of no use at `now`: invitations and sessions that have expired, and sessions
    /// that were revoked a day ago or earlier. Call it now and then.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn prune(&self, now: i64) -> Result<(), RecordsError> {
        self.db()
            .write(move |connection| Box::pin(prune(connection, now)))
            .await
    }

    /// Deletes events and arenas that are older at `now`, or more, than `retention` says, and returns
    /// how many. Of arenas, the one of the earliest time that is kept stays. What would take long is left
    /// for the next call.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn prune_events(
        &self,
        retention: EventRetention,
        now: i64,
    ) -> Result<u64, RecordsError> {
        let before = now.saturating_sub(retention.ms);
        let events = self.events().prune(before, retention.events).await?;
        let arenas = self.arenas().prune(before, retention.arenas).await?;
        Ok(events + arenas)
    }

    fn db(&self) -> &Store {
        &self.0.db
    }
}

/// Refuses records of no bytes beside a history. A new server begins with such a file, but before there is
/// any history: these have been lost, and whoever comes next must not be taken for the first.
fn not_emptied(records: &Path, history: &Path) -> Result<(), RecordsError> {
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let is_empty = records.is_file() && length(records) == 0;
    if is_empty && length(&beside(records, "-wal")) == 0 && length(history) > 0 {
        return Err(RecordsError::damaged(
            records,
            "it is empty, although the server has run before",
        ));
    }
    Ok(())
}

async fn prune(connection: &mut Connection<'_>, now: i64) -> Result<(), RecordsError> {
    /// Longer than any access token lives: until then a revoked session must be known as such.
    const KEEP_REVOKED: i64 = 24 * 3_600_000;
    query("DELETE FROM invitation WHERE expires <= $1")
        .bind(now)
        .execute(connection)
        .await?;
    query("DELETE FROM session WHERE expires <= $1 OR revoked <= $1")
        .bind(now.saturating_sub(KEEP_REVOKED))
        .execute(connection)
        .await?;
    Ok(())
}
