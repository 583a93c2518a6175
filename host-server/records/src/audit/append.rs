//! How an entry comes behind the others, also where somebody has put something there.

use sha2::{Digest as _, Sha256};

use super::{Canonical, Entry, FOREIGN, Row, split};
use crate::RecordsError;
use crate::query::{Connection, query};
use crate::text::hex;

/// Appends an entry behind `before`, the last one and its hash; returns its own.
pub(super) async fn append(
    connection: &mut Connection<'_>,
    entry: Canonical,
    (last, before): (i64, Vec<u8>),
) -> Result<(i64, Vec<u8>), RecordsError> {
    let seq = last + 1;
    let hash = entry.hash(seq, &before).to_vec();
    query("INSERT INTO audit VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)")
        .bind(seq)
        .bind(entry.at)
        .bind(entry.who)
        .bind(entry.from)
        .bind(entry.action)
        .bind(entry.target)
        .bind(entry.detail)
        .bind(entry.outcome)
        .bind(hash.clone())
        .execute(&mut *connection)
        .await?;
    move_end(connection, seq, hash.clone()).await?;
    Ok((seq, hash))
}

async fn move_end(
    connection: &mut Connection<'_>,
    seq: i64,
    hash: Vec<u8>,
) -> Result<(), RecordsError> {
    query("UPDATE audit_end SET seq = $1, hash = $2 WHERE one = 1")
        .bind(seq)
        .bind(hash)
        .execute(connection)
        .await?;
    Ok(())
}

/// Goes past entries that somebody has put behind the end, where they keep the next one out, and writes
/// down that they are there. They stay as they are: they are evidence. Returns the end.
pub(super) async fn pass_foreign(
    connection: &mut Connection<'_>,
    end: (i64, Vec<u8>),
    at: i64,
) -> Result<(i64, Vec<u8>), RecordsError> {
    let first = end.0 + 1;
    let mut end = end;
    // What they should have been: their own hashes may say anything.
    let mut content = Sha256::new();
    loop {
        let row: Option<Row> = query(
            "SELECT seq, at, who, came_from, action, target, detail, outcome, hash FROM audit
             WHERE seq = $1",
        )
        .bind(end.0 + 1)
        .fetch_optional(&mut *connection)
        .await?;
        let Some(row) = row else { break };
        let (seq, entry, hash) = split(row);
        content.update(entry.hash(seq, &end.1));
        move_end(connection, seq, hash.clone()).await?;
        end = (seq, hash);
    }
    if end.0 < first {
        return Ok(end);
    }
    let detail = serde_json::json!({
        "first": first,
        "last": end.0,
        "content": hex(&content.finalize()),
    });
    let note = Entry {
        at,
        who: "server".to_owned(),
        from: String::new(),
        action: FOREIGN.to_owned(),
        target: first.to_string(),
        detail,
        outcome: "found behind the end of the log, not written by it".to_owned(),
    };
    append(connection, Canonical::new(&note), end).await
}
