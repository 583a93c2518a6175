//! Who did what: an append-only log whose entries each seal the one before.
//!
//! The hash of an entry covers the hash of its predecessor and every field of its own, each with its
//! length in front, so that no two entries look alike to it. Whoever changes, removes or inserts an
//! entry in the file must compute all later hashes anew; whoever keeps a copy of one later hash sees
//! it. The database refuses such statements too, but only from those who use it as it is.

mod append;

use std::io::Write;

use serde::Serialize;
use serde_json::Value;
use sha2::{Digest as _, Sha256};

use crate::RecordsError;
use crate::query::{Connection, query};
use crate::store::Store;
use crate::text::{cut, hex};
use append::{append, pass_foreign};

/// Most entries in one answer.
pub const MAX_AUDIT_PAGE: u32 = 1_000;
const MAX_WHO: usize = 64;
const MAX_FROM: usize = 128;
const MAX_ACTION: usize = 64;
const MAX_TARGET: usize = 128;
const MAX_OUTCOME: usize = 128;
const MAX_DETAIL: usize = 8_192;
/// Entries that are checked or written out at a time.
const PAGE: u32 = 500;
/// What the log itself writes down when it finds entries that it has not written. From outside nobody
/// can: actions are words of this program.
const FOREIGN: &str = "audit.foreign";
/// What stands where entries are missing that could neither be written nor kept.
const GAP: &str = "audit.gap";
/// Set before every entry's fields: a hash of something else is never one of an entry.
const DOMAIN: &[u8] = b"terracrawler audit 1";

/// Something that somebody did, or tried to.
///
/// A text that is too long is cut off: what an attacker sends must not keep the entry out of the log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Entry {
    /// When.
    pub at: i64,
    /// Who: an account, a robot, `server`; 64 bytes.
    pub who: String,
    /// From where: an address, `console`; 128 bytes.
    pub from: String,
    /// What, as a stable word: `login`, `command`; 64 bytes.
    pub action: String,
    /// To whom or what; 128 bytes.
    pub target: String,
    /// The particulars; 8 KiB of JSON.
    pub detail: Value,
    /// What came of it: `ok`, or a reason; 128 bytes.
    pub outcome: String,
}

impl Entry {
    /// Tells that `entries` of them are missing, which came from `from` to `to`, Unix milliseconds. It
    /// stands where they would.
    #[must_use]
    pub fn gap(entries: u64, from: i64, to: i64) -> Self {
        Self {
            at: to,
            who: "server".to_owned(),
            from: String::new(),
            action: GAP.to_owned(),
            target: String::new(),
            detail: serde_json::json!({ "entries": entries, "from": from, "to": to }),
            outcome: "lost: the log could not be written, and too many waited".to_owned(),
        }
    }
}

/// An entry as it is in the log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stored {
    /// Its number; the first is 1, and none is missing.
    pub seq: u64,
    /// What was done.
    #[serde(flatten)]
    pub entry: Entry,
    /// Seals it and everything before it; 64 hexadecimal digits.
    pub hash: String,
}

/// Where the log stops being what was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Broken {
    /// The first entry that is not as it was.
    pub seq: u64,
    /// In what way.
    pub why: String,
}

impl std::fmt::Display for Broken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "audit entry {}: {}", self.seq, self.why)
    }
}

impl std::error::Error for Broken {}

/// An entry in the form in which it is hashed and kept.
struct Canonical {
    at: i64,
    who: String,
    from: String,
    action: String,
    target: String,
    detail: String,
    outcome: String,
}

type Row = (
    i64,
    i64,
    String,
    String,
    String,
    String,
    String,
    String,
    Vec<u8>,
);

impl Canonical {
    fn new(entry: &Entry) -> Self {
        let mut detail = entry.detail.to_string();
        if detail.len() > MAX_DETAIL {
            // Quotes and backslashes double, so half of it fits whatever it is.
            detail = serde_json::json!({ "cut": cut(&detail, MAX_DETAIL / 3) }).to_string();
        }
        Self {
            at: entry.at,
            who: cut(&entry.who, MAX_WHO),
            from: cut(&entry.from, MAX_FROM),
            action: cut(&entry.action, MAX_ACTION),
            target: cut(&entry.target, MAX_TARGET),
            detail,
            outcome: cut(&entry.outcome, MAX_OUTCOME),
        }
    }

    fn hash(&self, seq: i64, before: &[u8]) -> [u8; 32] {
        let mut hash = Sha256::new();
        hash.update(DOMAIN);
        hash.update(before);
        hash.update(seq.to_be_bytes());
        hash.update(self.at.to_be_bytes());
        for text in [
            &self.who,
            &self.from,
            &self.action,
            &self.target,
            &self.detail,
            &self.outcome,
        ] {
            hash.update((text.len() as u64).to_be_bytes());
            hash.update(text.as_bytes());
        }
        hash.finalize().into()
    }
}

fn split(row: Row) -> (i64, Canonical, Vec<u8>) {
    let (seq, at, who, from, action, target, detail, outcome, hash) = row;
    let entry = Canonical {
        at,
        who,
        from,
        action,
        target,
        detail,
        outcome,
    };
    (seq, entry, hash)
}

fn stored(row: Row) -> Stored {
    let (seq, entry, hash) = split(row);
    // A detail that is no JSON was tampered with: shown as it is, and found by `audit_verify`.
    let detail = serde_json::from_str(&entry.detail).unwrap_or(Value::String(entry.detail));
    Stored {
        seq: seq as u64,
        entry: Entry {
            at: entry.at,
            who: entry.who,
            from: entry.from,
            action: entry.action,
            target: entry.target,
            detail,
            outcome: entry.outcome,
        },
        hash: hex(&hash),
    }
}

async fn end(connection: &mut Connection<'_>) -> Result<(i64, Vec<u8>), RecordsError> {
    query("SELECT seq, hash FROM audit_end WHERE one = 1")
        .fetch_one(connection)
        .await
}

async fn after(
    connection: &mut Connection<'_>,
    seq: i64,
    up_to: i64,
) -> Result<Vec<Row>, RecordsError> {
    query(
        "SELECT seq, at, who, came_from, action, target, detail, outcome, hash FROM audit
         WHERE seq > $1 AND seq <= $2 ORDER BY seq LIMIT $3",
    )
    .bind(seq)
    .bind(up_to)
    .bind(i64::from(PAGE))
    .fetch_all(connection)
    .await
}

/// Appends entries in their order, within a transaction that changes other things as well.
pub(crate) async fn append_all(
    connection: &mut Connection<'_>,
    entries: &[Entry],
) -> Result<(), RecordsError> {
    let mut end = end(connection).await?;
    for entry in entries {
        let entry = Canonical::new(entry);
        end = pass_foreign(connection, end, entry.at).await?;
        end = append(connection, entry, end).await?;
    }
    Ok(())
}

/// The audit log among the records.
#[derive(Debug, Clone, Copy)]
pub struct Audit<'r>(pub(crate) &'r Store);

impl Audit<'_> {
    /// Appends an entry and returns its number, once it is on disk. Entries that somebody else has put
    /// there are passed, which an entry of its own tells and [`Self::verify`] for ever after.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn append(self, entry: Entry) -> Result<u64, RecordsError> {
        let entry = Canonical::new(&entry);
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let end = end(connection).await?;
                    let end = pass_foreign(connection, end, entry.at).await?;
                    let (seq, _) = append(connection, entry, end).await?;
                    Ok(seq as u64)
                })
            })
            .await
    }

    /// Appends entries in their order, all or none of them, and returns when they are on disk. As
    /// [`Audit::append`] for the rest.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be written.
    pub async fn append_all(self, entries: Vec<Entry>) -> Result<(), RecordsError> {
        self.0
            .write(move |connection| {
                Box::pin(async move { append_all(connection, &entries).await })
            })
            .await
    }

    /// How many entries are missing, by what the log itself says: see [`Entry::gap`].
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn lost(self) -> Result<u64, RecordsError> {
        let gaps: Vec<(String,)> = self
            .0
            .read(|connection| {
                Box::pin(async move {
                    query("SELECT detail FROM audit WHERE action = $1")
                        .bind(GAP.to_owned())
                        .fetch_all(connection)
                        .await
                })
            })
            .await?;
        let count = |(detail,): (String,)| {
            let detail: Option<Value> = serde_json::from_str(&detail).ok();
            detail.and_then(|detail| detail["entries"].as_u64())
        };
        Ok(gaps.into_iter().filter_map(count).sum())
    }

    /// Up to `limit` entries before number `before`, or the last ones, newest first; only those of
    /// `who` where one is named.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn page(
        self,
        before: Option<u64>,
        limit: u32,
        who: Option<&str>,
    ) -> Result<Vec<Stored>, RecordsError> {
        let before = before.map_or(i64::MAX, |seq| i64::try_from(seq).unwrap_or(i64::MAX));
        let limit = limit.min(MAX_AUDIT_PAGE);
        let who = who.map(|who| cut(who, MAX_WHO));
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let fields = match who {
                        // Two statements, since one for both cases would use neither's index.
                        Some(who) => query(
                            "SELECT seq, at, who, came_from, action, target, detail, outcome, hash
                             FROM audit WHERE seq < $1 AND who = $2 ORDER BY seq DESC LIMIT $3",
                        )
                        .bind(before)
                        .bind(who),
                        None => query(
                            "SELECT seq, at, who, came_from, action, target, detail, outcome, hash
                             FROM audit WHERE seq < $1 ORDER BY seq DESC LIMIT $2",
                        )
                        .bind(before),
                    };
                    let rows: Vec<Row> =
                        fields.bind(i64::from(limit)).fetch_all(connection).await?;
                    Ok(rows.into_iter().map(stored).collect())
                })
            })
            .await
    }

    /// Checks every entry against the one before, and returns how many there are.
    ///
    /// # Errors
    /// [`Broken`] names the first entry that is not what was written, or cannot be read.
    pub async fn verify(self) -> Result<u64, Broken> {
        let unreadable = |seq: i64, error: &RecordsError| Broken {
            seq: seq as u64,
            why: format!("it cannot be read: {error}"),
        };
        // The end is read first: entries that come in meanwhile are behind it, and left out.
        let (last, sealed) = self
            .0
            .read(|connection| Box::pin(end(connection)))
            .await
            .map_err(|error| unreadable(1, &error))?;
        let mut hash = vec![0; 32];
        let mut seq = 0;
        while seq < last {
            let rows = self
                .0
                .read(move |connection| Box::pin(after(connection, seq, last)))
                .await
                .map_err(|error| unreadable(seq + 1, &error))?;
            if rows.is_empty() {
                return Err(broken(seq + 1, "it is missing"));
            }
            for row in rows {
                let (found, entry, its_hash) = split(row);
                if found != seq + 1 {
                    return Err(broken(seq + 1, "it is missing"));
                }
                if entry.hash(found, &hash).as_slice() != its_hash {
                    return Err(broken(found, "it was changed, or one before it was"));
                }
                if entry.action == FOREIGN {
                    let first = entry.target.parse().unwrap_or(found);
                    return Err(broken(first, NOT_OURS));
                }
                (seq, hash) = (found, its_hash);
            }
        }
        if hash != sealed {
            return Err(broken(
                last.max(1),
                "it is not the one that was written last",
            ));
        }
        // In one statement: entries that come in meanwhile move the end along.
        let foreign: Option<(i64,)> = self
            .0
            .read(|connection| {
                Box::pin(async move {
                    query(
                        "SELECT seq FROM audit
                         WHERE seq < 1 OR seq > (SELECT seq FROM audit_end WHERE one = 1)
                         ORDER BY seq LIMIT 1",
                    )
                    .fetch_optional(connection)
                    .await
                })
            })
            .await
            .map_err(|error| unreadable(last + 1, &error))?;
        match foreign {
            Some((seq,)) => Err(broken(seq, NOT_OURS)),
            None => Ok(last as u64),
        }
    }

    /// Writes the log as JSON, one entry a line, oldest first, and returns how many there are.
    ///
    /// # Errors
    /// [`RecordsError::Io`] when `to` refuses, others when the log cannot be read.
    pub async fn export(self, to: &mut (dyn Write + Send)) -> Result<u64, RecordsError> {
        let refused = |error| RecordsError::io(std::path::Path::new("export"), error);
        let (last, _) = self.0.read(|connection| Box::pin(end(connection))).await?;
        let (mut seq, mut count) = (0, 0);
        loop {
            let rows = self
                .0
                .read(move |connection| Box::pin(after(connection, seq, last)))
                .await?;
            if rows.is_empty() {
                to.flush().map_err(refused)?;
                return Ok(count);
            }
            for row in rows {
                seq = row.0;
                count += 1;
                let line = serde_json::to_string(&stored(row))
                    .map_err(|error| refused(std::io::Error::other(error)))?;
                writeln!(to, "{line}").map_err(refused)?;
            }
        }
    }
}

/// Why an entry outside of the chain is not one of the log.
const NOT_OURS: &str = "it was put there by something else than this program";

fn broken(seq: i64, why: &str) -> Broken {
    Broken {
        seq: seq.max(0) as u64,
        why: why.to_owned(),
    }
}
