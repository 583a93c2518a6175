//! Releases: what robots may be updated to. Whether one is genuine, whoever keeps it here has found out.
//!
//! An image is kept in pieces, so that nobody who wants a part of it reads all of it.

use std::collections::BTreeSet;

use crawler_protocol::ReleaseId;
use crawler_release::{
    ENVELOPE_MAX, Kind, MAX_BUILD, MAX_IMAGE, MAX_NAME, MAX_VERSION, Malformed, Signed,
};
use serde_json::{Value, json};
use sqlx::AssertSqlSafe;

use crate::RecordsError;
use crate::query::changed;
use crate::query::{Connection, query};
use crate::store::Store;
use crate::text::cut;

/// Most releases. Beyond, the oldest of those that were withdrawn makes room.
pub const MAX_RELEASES: i64 = 1_000;
/// Most bytes that all images together may have.
pub const MAX_RELEASE_BYTES: i64 = 256 * 1024 * 1024;
/// Most bytes of a report on what a release was tried on.
pub const MAX_RELEASE_GATE: usize = 256 * 1024;
/// Longest reason for which a release is withdrawn, in bytes; the rest is cut off.
pub const MAX_RELEASE_REASON: usize = 512;
/// Bytes of a piece, but for the last one of an image.
pub const RELEASE_PIECE: usize = 64 * 1024;
/// Longest name of who did something, in bytes; the rest is cut off.
const MAX_BY: usize = 64;
/// Bytes of an id.
const ID: usize = 16;

/// A release to be kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewRelease {
    /// Its id, 16 characters.
    pub id: String,
    /// `program` or `model`.
    pub kind: String,
    /// Name of the model; `None` for programs.
    pub name: Option<String>,
    /// The board that it is for.
    pub board: String,
    /// Version, for people.
    pub version: String,
    /// Build id.
    pub build: String,
    /// Its sequence, at least 1.
    pub sequence: u32,
    /// The least sequence that a robot takes afterwards.
    pub floor: u32,
    /// From when on no robot takes it, Unix time in seconds.
    pub expires: Option<i64>,
    /// Its manifest, with the signature.
    pub envelope: Vec<u8>,
    /// Its image.
    pub image: Vec<u8>,
    /// Who added it.
    pub by: String,
    /// When, Unix milliseconds.
    pub added: i64,
}

impl NewRelease {
    /// A release as its manifest describes it: the one of `envelope`, whose signature the caller has verified, as
    /// well as that `image` is the one that was signed.
    ///
    /// # Errors
    /// When the manifest cannot be read.
    pub fn of(envelope: &[u8], image: &[u8], by: &str, added: i64) -> Result<Self, Malformed> {
        let signed = Signed::parse(envelope)?;
        let manifest = signed.unverified()?;
        Ok(Self {
            id: ReleaseId::new(signed.id()).to_string(),
            kind: column(manifest.kind).to_owned(),
            name: manifest.name.map(str::to_owned),
            board: manifest.board.to_owned(),
            version: manifest.version.to_owned(),
            build: manifest.build.to_owned(),
            sequence: manifest.sequence,
            floor: manifest.floor,
            // What is beyond the end of time never comes.
            expires: manifest
                .expires
                .map(|end| i64::try_from(end).unwrap_or(i64::MAX)),
            envelope: envelope.to_vec(),
            image: image.to_vec(),
            by: by.to_owned(),
            added,
        })
    }

    /// What the audit log says of it.
    #[must_use]
    pub fn for_audit(&self) -> Value {
        json!({
            "kind": self.kind,
            "name": self.name,
            "board": self.board,
            "version": self.version,
            "build": self.build,
            "sequence": self.sequence,
            "size": self.image.len(),
        })
    }
}

/// What stands in the column of kinds: a policy is a model there, and its manifest says more.
const fn column(kind: Kind) -> &'static str {
    match kind {
        Kind::Program => "program",
        Kind::Model | Kind::Policy => "model",
    }
}

/// Who has withdrawn a release, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Withdrawal {
    /// Who.
    pub by: String,
    /// When, Unix milliseconds.
    pub at: i64,
    /// For which reason.
    pub why: String,
}

/// A release as it is kept, without its image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptRelease {
    /// Its id.
    pub id: String,
    /// `program` or `model`.
    pub kind: String,
    /// Name of the model; `None` for programs.
    pub name: Option<String>,
    /// The board that it is for.
    pub board: String,
    /// Version, for people.
    pub version: String,
    /// Build id.
    pub build: String,
    /// Its sequence.
    pub sequence: u32,
    /// The least sequence that a robot takes afterwards.
    pub floor: u32,
    /// From when on no robot takes it, Unix time in seconds.
    pub expires: Option<i64>,
    /// Bytes of its image.
    pub size: u32,
    /// Its manifest, with the signature.
    pub envelope: Vec<u8>,
    /// Whether it passed what it was tried on; `None` where there is no report.
    pub passed: Option<bool>,
    /// Who added it.
    pub by: String,
    /// When, Unix milliseconds.
    pub added: i64,
    /// Set once it was withdrawn: its image is gone.
    pub withdrawn: Option<Withdrawal>,
}

impl KeptRelease {
    /// What its image is, as its manifest says.
    #[must_use]
    pub fn what(&self) -> Option<Kind> {
        let signed = Signed::parse(&self.envelope).ok();
        let manifest = signed.and_then(|signed| signed.unverified().ok());
        let kind = manifest.map(|manifest| manifest.kind);
        // One whose manifest cannot be read is what the column says.
        let mut all = kind.into_iter().chain(Kind::ALL);
        all.find(|kind| column(*kind) == self.kind)
    }
}

/// Its columns. A row has at most sixteen, so the last of them holds two.
type Row = (
    String,
    String,
    Option<String>,
    String,
    String,
    String,
    i64,
    i64,
    Option<i64>,
    i64,
    Vec<u8>,
    Option<i64>,
    String,
    i64,
    Option<i64>,
    String,
);

/// The last one holds who has withdrawn it, a line feed, and why: no name has one.
const COLUMNS: &str = "id, kind, name, board, version, build, sequence, floor, expires, size, envelope, passed, \
                       added_by, added, withdrawn, \
                       coalesce(withdrawn_by, '') || '\n' || coalesce(why, '')";

fn release(row: Row) -> Result<KeptRelease, RecordsError> {
    let (
        id,
        kind,
        name,
        board,
        version,
        build,
        sequence,
        floor,
        expires,
        size,
        envelope,
        passed,
        by,
        added,
        withdrawn,
        who,
    ) = row;
    let number = |number: i64| {
        u32::try_from(number)
            .map_err(|_| RecordsError::Invalid("an invalid number of a release is stored"))
    };
    let withdrawal = |at| {
        let (by, why) = who.split_once('\n').unwrap_or((&who, ""));
        let (by, why) = (by.to_owned(), why.to_owned());
        Withdrawal { by, at, why }
    };
    Ok(KeptRelease {
        id,
        kind,
        name,
        board,
        version,
        build,
        sequence: number(sequence)?,
        floor: number(floor)?,
        expires,
        size: number(size)?,
        envelope,
        passed: passed.map(|passed| passed != 0),
        by,
        added,
        withdrawn: withdrawn.map(withdrawal),
    })
}

fn check(new: &NewRelease) -> Result<(), RecordsError> {
    let within = |text: &str, most: usize| (1..=most).contains(&text.len()) && text.is_ascii();
    let texts = [
        (&new.board, MAX_NAME),
        (&new.version, MAX_VERSION),
        (&new.build, MAX_BUILD),
        (new.name.as_ref().unwrap_or(&new.board), MAX_NAME),
    ];
    let kind = Kind::ALL.map(Kind::name).contains(&&*new.kind);
    if !kind || texts.iter().any(|(text, most)| !within(text, *most)) || !is_id(&new.id) {
        return Err(RecordsError::Invalid("no release has such a name"));
    }
    if new.sequence == 0 || new.floor > new.sequence {
        return Err(RecordsError::Invalid("no release has such a sequence"));
    }
    if new.image.is_empty() || new.image.len() > MAX_IMAGE as usize {
        return Err(RecordsError::Invalid("an image has 1 to 4718592 bytes"));
    }
    if new.envelope.len() > ENVELOPE_MAX {
        return Err(RecordsError::Invalid("an envelope has at most 1024 bytes"));
    }
    Ok(())
}

fn is_id(text: &str) -> bool {
    text.len() == ID && text.bytes().all(|byte| byte.is_ascii_alphanumeric())
}

/// Where a piece is.
fn place(id: &str, piece: usize) -> String {
    format!("{id}-{piece:03}")
}

async fn find(
    connection: &mut Connection<'_>,
    id: &str,
) -> Result<Option<KeptRelease>, RecordsError> {
    let sql = format!("SELECT {COLUMNS} FROM release WHERE id = $1");
    let row: Option<Row> = query(AssertSqlSafe(sql))
        .bind(id)
        .fetch_optional(connection)
        .await?;
    row.map(release).transpose()
}

/// Refuses when there are too many, or the image is too much beside the others.
async fn make_room(connection: &mut Connection<'_>, bytes: i64) -> Result<(), RecordsError> {
    let (count, taken): (i64, i64) = query(
        "SELECT count(*), CAST(coalesce(sum(CASE WHEN withdrawn IS NULL THEN size ELSE 0 END), 0) AS BIGINT)
         FROM release",
    )
    .fetch_one(&mut *connection)
    .await?;
    if taken + bytes > MAX_RELEASE_BYTES {
        return Err(RecordsError::TooMany("bytes of releases"));
    }
    if count >= MAX_RELEASES {
        let forgotten = query(
            "DELETE FROM release WHERE id IN
             (SELECT id FROM release WHERE withdrawn IS NOT NULL ORDER BY added, id LIMIT 1)",
        )
        .execute(connection)
        .await?;
        changed(forgotten, RecordsError::TooMany("releases"))?;
    }
    Ok(())
}

async fn add(connection: &mut Connection<'_>, new: NewRelease) -> Result<(), RecordsError> {
    if find(connection, &new.id).await?.is_some() {
        return Err(RecordsError::Exists);
    }
    make_room(connection, new.image.len() as i64).await?;
    query(
        "INSERT INTO release (id, kind, name, board, version, build, sequence, floor, expires, size, envelope,
         added_by, added) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13)",
    )
    .bind(&new.id)
    .bind(new.kind)
    .bind(new.name)
    .bind(new.board)
    .bind(new.version)
    .bind(new.build)
    .bind(i64::from(new.sequence))
    .bind(i64::from(new.floor))
    .bind(new.expires)
    .bind(new.image.len() as i64)
    .bind(new.envelope)
    .bind(cut(&new.by, MAX_BY))
    .bind(new.added)
    .execute(&mut *connection)
    .await?;
    for (piece, data) in new.image.chunks(RELEASE_PIECE).enumerate() {
        query("INSERT INTO release_piece (place, data) VALUES ($1, $2)")
            .bind(place(&new.id, piece))
            .bind(data.to_vec())
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

async fn withdraw(
    connection: &mut Connection<'_>,
    id: &str,
    withdrawal: Withdrawal,
) -> Result<KeptRelease, RecordsError> {
    let before = find(connection, id).await?.ok_or(RecordsError::NotFound)?;
    if before.withdrawn.is_some() {
        return Err(RecordsError::Exists);
    }
    query("UPDATE release SET withdrawn_by = $1, withdrawn = $2, why = $3 WHERE id = $4")
        .bind(cut(&withdrawal.by, MAX_BY))
        .bind(withdrawal.at)
        .bind(cut(&withdrawal.why, MAX_RELEASE_REASON))
        .bind(id)
        .execute(&mut *connection)
        .await?;
    query("DELETE FROM release_piece WHERE place > $1 AND place < $2")
        .bind(format!("{id}-"))
        .bind(format!("{id}."))
        .execute(&mut *connection)
        .await?;
    find(connection, id).await?.ok_or(RecordsError::NotFound)
}

/// The releases among the records.
#[derive(Debug, Clone, Copy)]
pub struct Releases<'r>(pub(crate) &'r Store);

impl Releases<'_> {
    /// Keeps a release.
    ///
    /// # Errors
    /// [`RecordsError::Exists`] when there is, or was, one of its id; [`RecordsError::TooMany`] when there are too
    /// many, or their images have too many bytes; [`RecordsError::Invalid`] for what no release can be.
    pub async fn add(self, new: NewRelease) -> Result<(), RecordsError> {
        check(&new)?;
        self.0
            .write(move |connection| Box::pin(add(connection, new)))
            .await
    }

    /// The release of that id.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn get(self, id: &str) -> Result<Option<KeptRelease>, RecordsError> {
        let id = id.to_owned();
        self.0
            .read(move |connection| Box::pin(async move { find(connection, &id).await }))
            .await
    }

    /// The ids of all releases that were not withdrawn.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn in_force(self) -> Result<BTreeSet<String>, RecordsError> {
        self.0
            .read(|connection| {
                Box::pin(async move {
                    let rows: Vec<(String,)> =
                        query("SELECT id FROM release WHERE withdrawn IS NULL")
                            .fetch_all(connection)
                            .await?;
                    Ok(rows.into_iter().map(|(id,)| id).collect())
                })
            })
            .await
    }

    /// Up to `limit` releases, those that were added last first: from the beginning, or those behind the release
    /// `before`, of which there are none where nobody knows that one.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn page(
        self,
        before: Option<&str>,
        limit: u32,
    ) -> Result<Vec<KeptRelease>, RecordsError> {
        let behind = match before {
            None => "",
            Some(_) => "WHERE (added, id) < (SELECT added, id FROM release WHERE id = $2)",
        };
        let sql =
            format!("SELECT {COLUMNS} FROM release {behind} ORDER BY added DESC, id DESC LIMIT $1");
        let before = before.map(str::to_owned);
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let mut rows = query(AssertSqlSafe(sql)).bind(i64::from(limit));
                    if let Some(before) = before {
                        rows = rows.bind(before);
                    }
                    let rows: Vec<Row> = rows.fetch_all(connection).await?;
                    rows.into_iter().map(release).collect()
                })
            })
            .await
    }

    /// A part of the image of a release: up to `most` bytes from byte `from` on, fewer at its end. `None` when there
    /// is no such release, or it was withdrawn. Reads the pieces that this part is in, and no others.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read, [`RecordsError::Invalid`] where a piece is missing.
    pub async fn image(
        self,
        id: &str,
        from: u32,
        most: usize,
    ) -> Result<Option<Vec<u8>>, RecordsError> {
        let id = id.to_owned();
        let from = from as usize;
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let found = find(connection, &id).await?;
                    let Some(release) = found.filter(|release| release.withdrawn.is_none()) else {
                        return Ok(None);
                    };
                    let end = from.saturating_add(most).min(release.size as usize);
                    if from >= end {
                        return Ok(Some(Vec::new()));
                    }
                    let first = from / RELEASE_PIECE;
                    let pieces: Vec<(Vec<u8>,)> = query(
                        "SELECT data FROM release_piece WHERE place >= $1 AND place <= $2 ORDER BY place",
                    )
                    .bind(place(&id, first))
                    .bind(place(&id, (end - 1) / RELEASE_PIECE))
                    .fetch_all(connection)
                    .await?;
                    let mut part: Vec<u8> = pieces.into_iter().flat_map(|(data,)| data).collect();
                    let begin = first * RELEASE_PIECE;
                    if part.len() < end - begin {
                        return Err(RecordsError::Invalid("a piece of an image is missing"));
                    }
                    part.truncate(end - begin);
                    part.drain(..from - begin);
                    Ok(Some(part))
                })
            })
            .await
    }

    /// Withdraws a release for good, and returns what is kept of it: all but its image.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], [`RecordsError::Exists`] when it was withdrawn before.
    pub async fn withdraw(
        self,
        id: &str,
        withdrawal: Withdrawal,
    ) -> Result<KeptRelease, RecordsError> {
        let id = id.to_owned();
        self.0
            .write(move |connection| {
                Box::pin(async move { withdraw(connection, &id, withdrawal).await })
            })
            .await
    }

    /// Keeps the report on what a release was tried on, in the place of one that is there.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], [`RecordsError::Invalid`] for one that is too long.
    pub async fn set_gate(self, id: &str, gate: Vec<u8>, passed: bool) -> Result<(), RecordsError> {
        if gate.len() > MAX_RELEASE_GATE {
            return Err(RecordsError::Invalid("a report has at most 256 KiB"));
        }
        let id = id.to_owned();
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let done = query("UPDATE release SET gate = $1, passed = $2 WHERE id = $3")
                        .bind(gate)
                        .bind(passed)
                        .bind(id)
                        .execute(connection)
                        .await?;
                    changed(done, RecordsError::NotFound)
                })
            })
            .await
    }

    /// The report on what a release was tried on; `None` where there is none.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn gate(self, id: &str) -> Result<Option<Vec<u8>>, RecordsError> {
        let id = id.to_owned();
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let row: Option<(Vec<u8>,)> =
                        query("SELECT gate FROM release WHERE id = $1 AND gate IS NOT NULL")
                            .bind(id)
                            .fetch_optional(connection)
                            .await?;
                    Ok(row.map(|(gate,)| gate))
                })
            })
            .await
    }
}
