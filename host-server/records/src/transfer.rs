//! All records from one engine into another: backups of a database are files, and files move into a
//! database.

use std::path::Path;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, Connection as _, PgConnection};

use crate::RecordsError;
use crate::query::{Connection, Value, Values, query};
use crate::schema::RECORDS;
use crawler_database::{Boxed, Transact as _};

/// Rows that are in memory at a time.
const PAGE: usize = 200;
/// Tables in an order in which none refers to a later one, with their columns. The first is the key. Who works on which
/// part of an experiment is left out: where the records come to, somebody else does.
const TABLES: &[(&str, &[&str])] = &[
    ("setting", &["key", "value"]),
    (
        "\"user\"",
        &["name", "role", "password", "created", "disabled"],
    ),
    ("invitation", &["digest", "name", "role", "expires"]),
    (
        "session",
        &[
            "id",
            "\"user\"",
            "came_from",
            "opened",
            "refreshed",
            "expires",
            "revoked",
        ],
    ),
    ("refresh", &["digest", "session", "used"]),
    (
        "credential",
        &["name", "digest", "created", "made_by", "revoked"],
    ),
    (
        "fence",
        &[
            "id", "name", "kind", "action", "corners", "made_by", "made_at",
        ],
    ),
    (
        "audit",
        &[
            "seq",
            "at",
            "who",
            "came_from",
            "action",
            "target",
            "detail",
            "outcome",
            "hash",
        ],
    ),
    ("audit_end", &["one", "seq", "hash"]),
    (
        "experiment",
        &[
            "id", "owner", "name", "recipe", "metrics", "results", "seeds", "made_by", "created",
            "started", "ended", "state", "reason", "done", "build", "kind",
        ],
    ),
    ("trial", &["id", "seed", "success", "reason", "measured"]),
    ("event", &["id", "at", "level", "robot", "text"]),
    ("arena", &["id", "at", "data"]),
    (
        "rollout",
        &[
            "id", "made_by", "made", "ended", "owner", "epoch", "beat", "document",
        ],
    ),
    ("rollout_robot", &["place", "state", "entry"]),
    ("rollout_note", &["place", "at", "what"]),
    (
        "release",
        &[
            "id",
            "kind",
            "name",
            "board",
            "version",
            "build",
            "sequence",
            "floor",
            "expires",
            "size",
            "envelope",
            "gate",
            "passed",
            "added_by",
            "added",
            "withdrawn_by",
            "withdrawn",
            "why",
        ],
    ),
    ("release_piece", &["place", "data"]),
];

/// Writes what the transaction of `from` sees into `file`, which is empty or not there.
pub(crate) async fn dump(
    from: &mut PgConnection,
    file: &Path,
    options: &SqliteConnectOptions,
) -> Result<(), RecordsError> {
    let mut to = SqliteConnection::connect_with(options).await?;
    RECORDS.migrate(&mut to, file).await?;
    to.run("BEGIN IMMEDIATE").await?;
    let guards: Vec<(String, String)> =
        query("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'")
            .fetch_all(&mut Connection::Sqlite(&mut to))
            .await?;
    for (name, _) in &guards {
        raw(&mut to, format!("DROP TRIGGER {name}")).await?;
    }
    let (sessions,): (i64,) =
        query("SELECT CASE WHEN is_called THEN last_value ELSE 0 END FROM session_id_seq")
            .fetch_one(&mut Connection::Postgres(from))
            .await?;
    copy(
        &mut Connection::Postgres(from),
        &mut Connection::Sqlite(&mut to),
    )
    .await?;
    let lent = &mut Connection::Sqlite(&mut to);
    query("DELETE FROM sqlite_sequence WHERE name = 'session'")
        .execute(lent)
        .await?;
    query("INSERT INTO sqlite_sequence (name, seq) VALUES ('session', $1)")
        .bind(sessions)
        .execute(lent)
        .await?;
    for (_, sql) in guards {
        raw(&mut to, sql).await?;
    }
    to.run("COMMIT").await?;
    Ok(to.close().await?)
}

/// Replaces what is in the database of `to`, in its transaction, by what is in `file`.
pub(crate) fn load<'a>(
    options: &'a SqliteConnectOptions,
    to: &'a mut PgConnection,
) -> Boxed<'a, Result<(), RecordsError>> {
    Box::pin(async move {
        let mut from = SqliteConnection::connect_with(options).await?;
        to.run(
            "ALTER TABLE audit DISABLE TRIGGER USER;
         ALTER TABLE audit_end DISABLE TRIGGER USER;
         DELETE FROM experiment_part",
        )
        .await?;
        let lent = &mut Connection::Sqlite(&mut from);
        let sessions: Option<(i64,)> =
            query("SELECT seq FROM sqlite_sequence WHERE name = 'session'")
                .fetch_optional(lent)
                .await?;
        copy(lent, &mut Connection::Postgres(to)).await?;
        let sessions = sessions.map_or(0, |(seq,)| seq).max(1);
        let _: (i64,) = query("SELECT setval('session_id_seq', $1)")
            .bind(sessions)
            .fetch_one(&mut Connection::Postgres(to))
            .await?;
        // What is copied brings its numbers; new ones come after them.
        to.run(
            "SELECT setval('event_id_seq', (SELECT coalesce(max(id), 1) FROM event)),
                setval('arena_id_seq', (SELECT coalesce(max(id), 1) FROM arena))",
        )
        .await?;
        to.run(
            "ALTER TABLE audit ENABLE TRIGGER USER;
         ALTER TABLE audit_end ENABLE TRIGGER USER",
        )
        .await?;
        Ok(from.close().await?)
    })
}

/// Whether there is anything but the tables.
pub(crate) async fn is_empty(connection: &mut PgConnection) -> Result<bool, RecordsError> {
    let (any,): (bool,) = query(
        "SELECT EXISTS (SELECT FROM setting) OR EXISTS (SELECT FROM \"user\")
         OR EXISTS (SELECT FROM credential) OR EXISTS (SELECT FROM audit)
         OR EXISTS (SELECT FROM experiment) OR EXISTS (SELECT FROM fence)
         OR EXISTS (SELECT FROM release)",
    )
    .fetch_one(&mut Connection::Postgres(connection))
    .await?;
    Ok(!any)
}

async fn copy(from: &mut Connection<'_>, to: &mut Connection<'_>) -> Result<(), RecordsError> {
    for (table, _) in TABLES.iter().rev() {
        query(AssertSqlSafe(format!("DELETE FROM {table}")))
            .execute(to)
            .await?;
    }
    for &(table, columns) in TABLES {
        let (key, names) = (columns[0], columns.join(", "));
        let mut last: Option<Value> = None;
        loop {
            let after = last
                .as_ref()
                .map_or_else(String::new, |_| format!("WHERE {key} > $1"));
            let mut page = query(AssertSqlSafe(format!(
                "SELECT {names} FROM {table} {after} ORDER BY {key} LIMIT {PAGE}"
            )));
            if let Some(last) = last.take() {
                page = page.bind(last);
            }
            let rows: Vec<Values> = page.fetch_all(from).await?;
            let Some(Values(newest)) = rows.last() else {
                break;
            };
            last = newest.first().cloned();
            insert(to, table, columns, rows).await?;
        }
    }
    Ok(())
}

async fn insert(
    to: &mut Connection<'_>,
    table: &str,
    columns: &[&str],
    rows: Vec<Values>,
) -> Result<(), RecordsError> {
    let row = |index: usize| {
        let places: Vec<String> = (1..=columns.len())
            .map(|column| format!("${}", index * columns.len() + column))
            .collect();
        format!("({})", places.join(", "))
    };
    let places: Vec<String> = (0..rows.len()).map(row).collect();
    let mut insert = query(AssertSqlSafe(format!(
        "INSERT INTO {table} ({}) VALUES {}",
        columns.join(", "),
        places.join(", ")
    )));
    for value in rows.into_iter().flat_map(|Values(values)| values) {
        insert = insert.bind(value);
    }
    insert.execute(to).await?;
    Ok(())
}

async fn raw(connection: &mut SqliteConnection, sql: String) -> Result<(), RecordsError> {
    sqlx::raw_sql(AssertSqlSafe(sql))
        .execute(connection)
        .await?;
    Ok(())
}
