//! A copy of the records while they are in use, and back.

use std::path::{Path, PathBuf};

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions as _, Connection as _, PgConnection};

use crate::schema::RECORDS;
use crate::store::Store;
use crate::{LOCK_FILE, RECORDS_FILE, Records, RecordsError, postgres, transfer};
use crawler_database::{
    Boxed, Db, Hold, Lock, Schema, Transact as _, beside, check_whole, make_private,
    remove_if_there, rename_if_there, sync, unreadable,
};
use crawler_history::{HISTORY, HISTORY_FILE, LOCK_FILE as HISTORY_LOCK};

/// End of the name of a file that is not complete.
const PARTIAL: &str = ".partial";

/// Writes a copy of both files into the directory `to`, which is made, or must be empty. The
/// records may be used meanwhile; the copy is what they were at one moment. When this returns,
/// it is checked and on disk. It is itself a directory that [`Records::open`] opens, also when
/// the records are in a database; a history that is elsewhere is left out.
///
/// # Errors
/// [`RecordsError::Exists`] when there is something in `to`, [`RecordsError::Invalid`] for
/// records in memory.
pub async fn create(records: &Records, to: &Path) -> Result<(), RecordsError> {
    if let Store::Sqlite(db) = records.db()
        && !db.on_disk()
    {
        return Err(RecordsError::Invalid("records in memory have no backup"));
    }
    std::fs::create_dir_all(to).map_err(|error| RecordsError::io(to, error))?;
    let mut inside = std::fs::read_dir(to).map_err(|error| RecordsError::io(to, error))?;
    if inside.next().is_some() {
        return Err(RecordsError::Exists);
    }
    if records.history().stats().keeper {
        records.history().flush().await?;
    }
    let file = to.join(RECORDS_FILE);
    let partial = beside(&file, PARTIAL);
    let copied = match records.db() {
        Store::Sqlite(db) => copy(db, &partial, &RECORDS).await,
        Store::Postgres(remote) => {
            let mut connection = remote.patient().await?;
            connection
                .run("BEGIN ISOLATION LEVEL REPEATABLE READ, READ ONLY")
                .await?;
            dump(&mut connection, &partial).await
        }
    };
    finish(copied, &partial, &file)?;
    if let Some(history) = records.history().db().filter(|db| db.on_disk()) {
        let file = to.join(HISTORY_FILE);
        let partial = beside(&file, PARTIAL);
        let copied = copy(history, &partial, &HISTORY).await;
        finish(copied, &partial, &file)?;
    }
    sync(to)
}

/// Puts the records of the directory `from`, which [`restore`] made, into the database
/// at `url`, which nobody may have open: all of them, or none. If it holds records, a backup of
/// those is put into the directory `aside`.
///
/// # Errors
/// [`RecordsError::Exists`] when the database holds records and there is no `aside`, others as
/// of [`Records::connect`] and [`restore`].
pub async fn restore_database(
    from: &Path,
    url: &str,
    aside: Option<&Path>,
) -> Result<(), RecordsError> {
    let file = from.join(RECORDS_FILE);
    if !file.is_file() {
        return Err(RecordsError::NotFound);
    }
    check(&file, &RECORDS).await?;
    let mut connection = postgres::alone(url).await?;
    if !transfer::is_empty(&mut connection).await? {
        let aside = aside.ok_or(RecordsError::Exists)?.join(RECORDS_FILE);
        let partial = beside(&aside, PARTIAL);
        finish(dump(&mut connection, &partial).await, &partial, &aside)?;
    }
    transfer::load(&options(&file), &mut connection).await?;
    connection.run("COMMIT").await?;
    postgres::leave(connection).await;
    Ok(())
}

/// Puts a backup in the place of the records in `dir`, which nobody may have open. It is checked
/// first; when it is no good, `dir` is as it was. The files that were there are kept in a
/// directory beside them, whose path is returned. A backup without history leaves the history.
///
/// Every session of the backup ends, since it may have been revoked after the backup was made. A
/// credential that was revoked after that is valid again: revoke it again.
///
/// # Errors
/// [`RecordsError::NotFound`] when there is no backup in `from`, [`RecordsError::InUse`],
/// [`RecordsError::Damaged`], [`RecordsError::Newer`], [`RecordsError::Foreign`].
pub async fn restore(from: &Path, dir: &Path) -> Result<PathBuf, RecordsError> {
    if !from.join(RECORDS_FILE).is_file() {
        return Err(RecordsError::NotFound);
    }
    std::fs::create_dir_all(dir).map_err(|error| RecordsError::io(dir, error))?;
    let _alone = Lock::take(&dir.join(LOCK_FILE), Hold::Alone)?
        .ok_or_else(|| RecordsError::InUse(dir.to_owned()))?;
    // A keeper that is still writing its last samples holds this one.
    let _still = Lock::take(&dir.join(HISTORY_LOCK), Hold::Alone)?
        .ok_or_else(|| RecordsError::InUse(dir.to_owned()))?;
    let now = crawler_history::now();
    let mut found = Vec::new();
    for (name, schema) in [(RECORDS_FILE, &RECORDS), (HISTORY_FILE, &HISTORY)] {
        let source = from.join(name);
        if !source.is_file() {
            continue;
        }
        let partial = beside(&dir.join(name), PARTIAL);
        if let Err(error) = bring(&source, &partial, schema, now).await {
            for name in [RECORDS_FILE, HISTORY_FILE] {
                remove_if_there(&beside(&dir.join(name), PARTIAL))?;
            }
            return Err(error);
        }
        found.push((dir.join(name), partial));
    }
    let replaced = dir.join(format!("replaced-{now}"));
    std::fs::create_dir_all(&replaced).map_err(|error| RecordsError::io(&replaced, error))?;
    for (file, partial) in found {
        replace(&file, &partial, &replaced).await?;
    }
    sync(dir)?;
    Ok(replaced)
}

fn options(file: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(file)
        .create_if_missing(false)
        .pragma("trusted_schema", "OFF")
        .disable_statement_logging()
}

/// Whether all of `file` can be read and is ours.
fn check<'a>(file: &'a Path, schema: &'a Schema) -> Boxed<'a, Result<(), RecordsError>> {
    Box::pin(async move {
        let mut connection = SqliteConnection::connect_with(&options(file))
            .await
            .map_err(|error| unreadable(error, file))?;
        let outcome = async {
            if schema.check(&mut connection, file).await? == 0 {
                return Err(RecordsError::damaged(file, "it is empty"));
            }
            check_whole(&mut connection, file).await
        }
        .await;
        connection.close().await?;
        outcome
    })
}

/// Gives what was made its name.
fn finish(made: Result<(), RecordsError>, partial: &Path, file: &Path) -> Result<(), RecordsError> {
    if let Err(error) = made {
        // Half a backup is worse than none: somebody might rely on it.
        remove_if_there(partial)?;
        return Err(error);
    }
    std::fs::rename(partial, file).map_err(|error| RecordsError::io(file, error))
}

/// What the transaction of `from` sees, as a file.
fn dump<'a>(from: &'a mut PgConnection, to: &'a Path) -> Boxed<'a, Result<(), RecordsError>> {
    Box::pin(async move {
        remove_if_there(to)?;
        make_private(to)?;
        transfer::dump(from, to, &options(to)).await?;
        check(to, &RECORDS).await?;
        sync(to)
    })
}

fn copy<'a>(db: &'a Db, to: &'a Path, schema: &'a Schema) -> Boxed<'a, Result<(), RecordsError>> {
    Box::pin(async move {
        make_private(to)?;
        let path = to
            .to_str()
            .ok_or(RecordsError::Invalid("the path of a backup is UTF-8"))?
            .to_owned();
        db.read(move |connection| {
            Box::pin(async move {
                sqlx::query("VACUUM INTO ?")
                    .bind(path)
                    .execute(connection)
                    .await?;
                Ok(())
            })
        })
        .await?;
        check(to, schema).await?;
        sync(to)
    })
}

/// Copies a file of a backup to where it will be needed, and makes it fit to be used.
fn bring<'a>(
    source: &'a Path,
    partial: &'a Path,
    schema: &'a Schema,
    now: i64,
) -> Boxed<'a, Result<(), RecordsError>> {
    Box::pin(async move {
        let log = beside(source, "-wal");
        if std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
            return Err(RecordsError::Invalid(
                "that is no backup but records in use: make a backup of them",
            ));
        }
        remove_if_there(partial)?;
        make_private(partial)?;
        std::fs::copy(source, partial).map_err(|error| RecordsError::io(source, error))?;
        check(partial, schema).await?;
        if schema.id == RECORDS.id {
            let mut connection = SqliteConnection::connect_with(&options(partial)).await?;
            schema.migrate(&mut connection, partial).await?;
            sqlx::query("UPDATE session SET revoked = ? WHERE revoked IS NULL")
                .bind(now)
                .execute(&mut connection)
                .await?;
            // Numbers of sessions that were opened after the backup must not come back.
            sqlx::query("UPDATE sqlite_sequence SET seq = seq + 1000000000 WHERE name = 'session'")
                .execute(&mut connection)
                .await?;
            connection.close().await?;
        }
        sync(partial)
    })
}

/// Puts `partial` in the place of `file`. At no moment is there no file: a server that starts after
/// a power cut must not believe that it is new.
fn replace<'a>(
    file: &'a Path,
    partial: &'a Path,
    replaced: &'a Path,
) -> Boxed<'a, Result<(), RecordsError>> {
    Box::pin(async move {
        let name = file.file_name().unwrap_or_default();
        let old = replaced.join(name);
        if file.is_file() {
            // Opening and closing it brings its log into it. A damaged one is kept as it is.
            if let Ok(mut connection) = SqliteConnection::connect_with(&options(file)).await {
                let merged = sqlx::raw_sql("PRAGMA wal_checkpoint(TRUNCATE)")
                    .execute(&mut connection)
                    .await;
                if let Err(error) = merged {
                    tracing::warn!(%error, "the old file keeps its log");
                }
                // The same: what matters is kept beside it.
                let _ = connection.close().await;
            }
            std::fs::copy(file, &old).map_err(|error| RecordsError::io(&old, error))?;
            sync(&old)?;
            for end in ["-wal", "-shm"] {
                rename_if_there(&beside(file, end), &beside(&old, end))?;
            }
        }
        std::fs::rename(partial, file).map_err(|error| RecordsError::io(file, error))
    })
}
