//! Opens the history: reads the tail again, and takes over from a crash.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crawler_database::{Db, Hold, Lock, RecordsError, beside, rename_if_there, unreadable};
use sqlx::SqliteConnection;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::memory::{Memory, Shared};
use super::writer::{HistoryWriter, TailRow, split};
use super::{HISTORY, HISTORY_FILE, History, codec, retention};

/// Held by the process that keeps the history.
pub const LOCK_FILE: &str = "history.lock";
/// Rows of the tail in memory at a time.
const PAGE: i64 = 16;

/// Keeps the history going.
#[derive(Debug)]
pub struct Running {
    /// The writer ends when this is dropped.
    alive: mpsc::Sender<()>,
    task: JoinHandle<()>,
}

impl Running {
    /// Returns when everything is written and the file is closed.
    ///
    /// # Cancellation safety
    /// It ends all the same.
    pub async fn end(self) {
        drop(self.alive);
        // An error is a panic of the task, which has been reported.
        let _ = self.task.await;
    }
}

/// What the file has that a start needs.
#[derive(Default)]
struct Loaded {
    memory: Memory,
    next_tail: i64,
    damaged: u64,
}

impl History {
    /// Opens the history in `dir`. The first process that does keeps it: it gets what keeps it going. Must be
    /// called within a Tokio runtime.
    ///
    /// A damaged file is put beside its name, and the history is begun anew.
    ///
    /// # Errors
    /// [`RecordsError`] when the file is of a newer program, or cannot be read or made.
    pub async fn open(dir: &Path) -> Result<(Self, Option<Running>), RecordsError> {
        let path = dir.join(HISTORY_FILE);
        let Some(lock) = Lock::take(&dir.join(LOCK_FILE), Hold::Alone)? else {
            let db = Db::open(&path, &HISTORY, false).await?;
            let shared = Arc::new(Shared::new(Memory::default(), None));
            let db = Some(db);
            return Ok((Self { shared, db }, None));
        };
        let (db, loaded, set_aside) = match load(&path).await {
            Ok((db, loaded)) => (db, loaded, None),
            // Old measurements are no reason for a fleet to stand still.
            Err(error) if is_damage(&error) => {
                let aside = set_aside(&path)?;
                tracing::error!(%error, put = %aside.display(), "the history is begun anew");
                let (db, loaded) = load(&path).await?;
                (db, loaded, Some(aside))
            }
            Err(error) => return Err(error),
        };
        Ok(Self::start(db, loaded, set_aside, Some(lock)))
    }

    /// No history: nothing is taken, nothing is known. For a server whose history is elsewhere.
    #[must_use]
    pub fn none() -> (Self, Option<Running>) {
        let shared = Arc::new(Shared::new(Memory::default(), None));
        (Self { shared, db: None }, None)
    }

    /// A history that is gone with the last handle. Must be called within a Tokio runtime.
    ///
    /// # Errors
    /// [`RecordsError`] when there is no memory for it.
    pub async fn in_memory() -> Result<(Self, Option<Running>), RecordsError> {
        let db = Db::in_memory(&HISTORY).await?;
        let loaded = read(&db).await?;
        Ok(Self::start(db, loaded, None, None))
    }

    fn start(
        db: Db,
        loaded: Loaded,
        set_aside: Option<PathBuf>,
        lock: Option<Lock>,
    ) -> (Self, Option<Running>) {
        let shared = Arc::new(Shared::new(loaded.memory, set_aside));
        shared
            .counts
            .damaged
            .store(loaded.damaged, Ordering::Relaxed);
        let writer = HistoryWriter::new(shared.clone(), db.clone(), loaded.next_tail, lock);
        // Never sent on: its end is the message.
        let (alive, ends) = mpsc::channel(1);
        let task = tokio::spawn(writer.run(ends));
        let running = Running { alive, task };
        let db = Some(db);
        (Self { shared, db }, Some(running))
    }
}

async fn load(path: &Path) -> Result<(Db, Loaded), RecordsError> {
    let db = Db::open(path, &HISTORY, false).await?;
    match read(&db).await {
        Ok(loaded) => Ok((db, loaded)),
        Err(error) => {
            db.close().await;
            Err(error)
        }
    }
}

async fn read(db: &Db) -> Result<Loaded, RecordsError> {
    let path = db.path().to_owned();
    let (robots, next_block, next_tail) = db
        .read(|connection| Box::pin(async move { heads(connection, &path).await }))
        .await?;
    let mut loaded = Loaded {
        memory: Memory {
            keeper: true,
            next_robot: robots.iter().map(|(number, _)| *number).max().unwrap_or(0) + 1,
            next_block,
            ..Memory::default()
        },
        next_tail,
        damaged: 0,
    };
    for (number, name) in robots {
        match name.parse() {
            Ok(robot) => {
                loaded.memory.numbers.insert(robot, number);
            }
            Err(_) => loaded.damaged += 1,
        }
    }
    let mut after = i64::MIN;
    loop {
        let path = db.path().to_owned();
        let rows = db
            .read(move |connection| Box::pin(async move { tail(connection, &path, after).await }))
            .await?;
        let Some(last) = rows.last() else { break };
        after = last.0;
        for (_, data) in &rows {
            let whole = codec::decode(data, |row: &TailRow| {
                let (raw, robot) = split(row);
                loaded.memory.open.entry(robot).or_default().push(raw);
                loaded.memory.open_count += 1;
            });
            loaded.damaged += u64::from(whole.is_none());
        }
    }
    Ok(loaded)
}

type Heads = (Vec<(i64, String)>, i64, i64);

async fn heads(connection: &mut SqliteConnection, path: &Path) -> Result<Heads, RecordsError> {
    let damaged = |error| unreadable(error, path);
    let robots = sqlx::query_as("SELECT id, name FROM robot")
        .fetch_all(&mut *connection)
        .await
        .map_err(damaged)?;
    let (next_block, next_tail): (i64, i64) = sqlx::query_as(
        "SELECT coalesce((SELECT max(id) FROM block), 0) + 1,
                coalesce((SELECT max(id) FROM tail), 0) + 1",
    )
    .fetch_one(connection)
    .await
    .map_err(damaged)?;
    Ok((robots, next_block, next_tail))
}

async fn tail(
    connection: &mut SqliteConnection,
    path: &Path,
    after: i64,
) -> Result<Vec<(i64, Vec<u8>)>, RecordsError> {
    sqlx::query_as("SELECT id, data FROM tail WHERE id > ? ORDER BY id LIMIT ?")
        .bind(after)
        .bind(PAGE)
        .fetch_all(connection)
        .await
        .map_err(|error| unreadable(error, path))
}

fn is_damage(error: &RecordsError) -> bool {
    matches!(
        error,
        RecordsError::Damaged { .. } | RecordsError::Foreign(_)
    )
}

/// Puts the file, and what belongs to it, where somebody may look at it.
fn set_aside(path: &Path) -> Result<PathBuf, RecordsError> {
    let aside = path.with_extension(format!("damaged-{}.sqlite", retention::now()));
    for end in ["-wal", "-shm", ""] {
        rename_if_there(&beside(path, end), &beside(&aside, end))?;
    }
    Ok(aside)
}
