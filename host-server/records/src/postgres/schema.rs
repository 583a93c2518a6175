//! The tables in `PostgreSQL`, and how a database gets from one version of them to the next.

use std::path::Path;

use sqlx::PgConnection;

use crate::RecordsError;
use crate::query::{Connection, query};
use crawler_database::Transact as _;

/// `STEPS[n]` leads from version n to n + 1. A step that was released is never edited.
const STEPS: &[&str] = &[
    include_str!("../schema/postgres.1.sql"),
    include_str!("../schema/postgres.experiments.sql"),
    include_str!("../schema/postgres.fences.sql"),
    include_str!("../schema/postgres.events.sql"),
    include_str!("../schema/postgres.rollouts.sql"),
    include_str!("../schema/postgres.releases.sql"),
    include_str!("../schema/postgres.parts.sql"),
    include_str!("../schema/postgres.trainings.sql"),
];
/// The oldest `PostgreSQL` that its makers still looked after when this was written, as it numbers
/// itself.
const OLDEST: i64 = 140_000;
/// What a whole database has beside the table of the version.
const TABLES: &[&str] = &[
    "arena",
    "audit",
    "audit_end",
    "credential",
    "event",
    "experiment",
    "experiment_part",
    "fence",
    "invitation",
    "refresh",
    "release",
    "release_piece",
    "rollout",
    "rollout_note",
    "rollout_robot",
    "session",
    "setting",
    "trial",
    "user",
];
const TRIGGERS: [&str; 7] = [
    "audit_end_follows",
    "audit_end_never_empties",
    "audit_end_stays",
    "audit_never_changes",
    "audit_never_empties",
    "audit_never_shrinks",
    "audit_only_grows",
];

/// Whether the database at `place` is one that this program can use. Returns the version of its
/// tables; 0 is an empty database.
pub(crate) async fn check(connection: &mut PgConnection, place: &str) -> Result<i64, RecordsError> {
    let connection = &mut Connection::Postgres(connection);
    let (server,): (i64,) = query("SELECT current_setting('server_version_num')::bigint")
        .fetch_one(connection)
        .await?;
    check_server(server, place)?;
    let tables: Vec<(String,)> =
        query("SELECT tablename::text FROM pg_tables WHERE schemaname = current_schema()")
            .fetch_all(connection)
            .await?;
    let has = |name: &str| tables.iter().any(|(table,)| table == name);
    let known = STEPS.len() as i64;
    if tables.is_empty() {
        return Ok(0);
    }
    if !has("terracrawler") {
        return Err(RecordsError::Foreign(place.into()));
    }
    let versions: Vec<(i64,)> = query("SELECT version FROM terracrawler")
        .fetch_all(connection)
        .await?;
    let found = match versions.as_slice() {
        [(version,)] => *version,
        _ => return Err(damaged(place, "it does not say of which version it is")),
    };
    if found > known {
        let file = place.into();
        return Err(RecordsError::Newer { file, found, known });
    }
    if found < known {
        // What is missing comes with the next steps.
        return Ok(found);
    }
    if let Some(table) = TABLES.iter().find(|table| !has(table)) {
        return Err(damaged(place, &format!("table {table} is missing")));
    }
    let triggers: Vec<(String,)> = query(
        "SELECT tgname::text FROM pg_trigger
         WHERE tgrelid IN (to_regclass('audit'), to_regclass('audit_end')) AND tgenabled <> 'D'",
    )
    .fetch_all(connection)
    .await?;
    let has = |name: &str| triggers.iter().any(|(trigger,)| trigger == name);
    if let Some(trigger) = TRIGGERS.iter().find(|trigger| !has(trigger)) {
        let why = format!("trigger {trigger}, which protects the audit log, is missing");
        return Err(damaged(place, &why));
    }
    Ok(found)
}

fn check_server(version: i64, place: &str) -> Result<(), RecordsError> {
    if version >= OLDEST {
        return Ok(());
    }
    Err(RecordsError::Refused(format!(
        "{place} is PostgreSQL {}, which is too old: {} or newer is needed",
        version / 10_000,
        OLDEST / 10_000
    )))
}

fn damaged(place: &str, why: &str) -> RecordsError {
    RecordsError::damaged(Path::new(place), why)
}

/// Brings the database to the newest version, all in the transaction that has begun and holds the
/// lock of writers: of several servers that start at once, one does it.
pub(crate) async fn migrate(
    connection: &mut PgConnection,
    place: &str,
) -> Result<(), RecordsError> {
    let found = check(connection, place).await?;
    for step in found..STEPS.len() as i64 {
        connection.run(STEPS[step as usize]).await?;
        query(
            "INSERT INTO terracrawler VALUES (1, $1)
             ON CONFLICT (one) DO UPDATE SET version = excluded.version",
        )
        .bind(step + 1)
        .execute(&mut Connection::Postgres(&mut *connection))
        .await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_server_is_refused_with_its_version() {
        assert!(check_server(150_018, "db").is_ok());
        assert!(check_server(OLDEST, "db").is_ok());
        let error = check_server(130_022, "postgres://db/fleet").expect_err("too old");
        assert_eq!(
            error.to_string(),
            "postgres://db/fleet is PostgreSQL 13, which is too old: 14 or newer is needed"
        );
    }
}
