//! Robots and simulators: one credential each.

use crawler_access::Digest;

use crate::RecordsError;
use crate::query::changed;
use crate::query::query;
use crate::store::Store;

/// Most credentials.
pub const MAX_CREDENTIALS: i64 = 100_000;
/// Longest name of the holder of a credential, in bytes.
pub const MAX_CREDENTIAL_NAME: usize = 64;
/// Longest name of who made a credential, in bytes; the rest is cut off.
const MAX_BY: usize = 64;

/// The credential of a robot or a simulator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Credential {
    /// Whose it is: a robot's id, or `simulator-` or `learner-` and a name.
    pub name: String,
    /// Digest of its secret.
    pub digest: Digest,
    /// When it was made.
    pub created: i64,
    /// Who made it.
    pub by: String,
    /// When it was revoked. Such a credential opens nothing.
    pub revoked: Option<i64>,
}

type Row = (String, Vec<u8>, i64, String, Option<i64>);

fn credential((name, digest, created, by, revoked): Row) -> Result<Credential, RecordsError> {
    let digest = digest
        .try_into()
        .map_err(|_| RecordsError::Invalid("an invalid digest is stored"))?;
    Ok(Credential {
        name,
        digest: Digest(digest),
        created,
        by,
        revoked,
    })
}

fn check_name(name: &str) -> Result<(), RecordsError> {
    let allowed = |byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_');
    if name.is_empty() || name.len() > MAX_CREDENTIAL_NAME || !name.bytes().all(allowed) {
        return Err(RecordsError::Invalid(
            "a credential is of a name of 1 to 64 letters a-z, digits, and -._",
        ));
    }
    Ok(())
}

/// The credentials of robots and simulators among the records.
#[derive(Debug, Clone, Copy)]
pub struct Credentials<'r>(pub(crate) &'r Store);

impl Credentials<'_> {
    /// Gives `name` the secret of that digest. One that it had is worth nothing from then on.
    ///
    /// # Errors
    /// [`RecordsError::Invalid`] for a name that is none, [`RecordsError::TooMany`].
    pub async fn enroll(
        self,
        name: &str,
        digest: Digest,
        now: i64,
        by: &str,
    ) -> Result<(), RecordsError> {
        check_name(name)?;
        let (name, by) = (name.to_owned(), crate::text::cut(by, MAX_BY));
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let (others,): (i64,) =
                        query("SELECT count(*) FROM credential WHERE name <> $1")
                            .bind(&name)
                            .fetch_one(&mut *connection)
                            .await?;
                    if others >= MAX_CREDENTIALS {
                        return Err(RecordsError::TooMany("credentials"));
                    }
                    query(
                        "INSERT INTO credential (name, digest, created, made_by, revoked)
                         VALUES ($1, $2, $3, $4, NULL)
                         ON CONFLICT (name) DO UPDATE SET digest = excluded.digest,
                         created = excluded.created, made_by = excluded.made_by, revoked = NULL",
                    )
                    .bind(name)
                    .bind(digest.0.to_vec())
                    .bind(now)
                    .bind(by)
                    .execute(connection)
                    .await?;
                    Ok(())
                })
            })
            .await
    }

    /// The credential of `name`, also one that was revoked.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn get(self, name: &str) -> Result<Option<Credential>, RecordsError> {
        if check_name(name).is_err() {
            return Ok(None);
        }
        let name = name.to_owned();
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let row: Option<Row> = query(
                        "SELECT name, digest, created, made_by, revoked FROM credential
                         WHERE name = $1",
                    )
                    .bind(name)
                    .fetch_optional(connection)
                    .await?;
                    row.map(credential).transpose()
                })
            })
            .await
    }

    /// Every credential, by name, also those that were revoked.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn all(self) -> Result<Vec<Credential>, RecordsError> {
        self.0
            .read(|connection| {
                Box::pin(async move {
                    let rows: Vec<Row> = query(
                        "SELECT name, digest, created, made_by, revoked FROM credential
                         ORDER BY name LIMIT $1",
                    )
                    .bind(MAX_CREDENTIALS)
                    .fetch_all(connection)
                    .await?;
                    rows.into_iter().map(credential).collect()
                })
            })
            .await
    }

    /// Revokes the credential of `name`. It stays listed.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when there is none, or it was revoked before.
    pub async fn revoke(self, name: &str, now: i64) -> Result<(), RecordsError> {
        check_name(name).map_err(|_| RecordsError::NotFound)?;
        let name = name.to_owned();
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let done = query(
                        "UPDATE credential SET revoked = $1 WHERE name = $2 AND revoked IS NULL",
                    )
                    .bind(now)
                    .bind(name)
                    .execute(connection)
                    .await?;
                    changed(done, RecordsError::NotFound)
                })
            })
            .await
    }
}
