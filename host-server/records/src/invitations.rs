//! Who may make an account, or complete one.

use crawler_access::{Digest, Role, UserName};

use crate::RecordsError;
use crate::account::{name, role};
use crate::query::changed;
use crate::query::query;
use crate::store::Store;

/// Most invitations that wait to be taken.
pub const MAX_INVITATIONS: i64 = 1_000;

/// Leave to make an account, or to complete one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Invitation {
    /// The account that it is for; without one the person chooses a name.
    pub name: Option<UserName>,
    /// What the account may do.
    pub role: Role,
    /// Worth nothing from then on.
    pub expires: i64,
}

type Invited = (Option<String>, String, i64);

fn invited(row: Option<Invited>, now: i64) -> Result<Option<Invitation>, RecordsError> {
    let Some((guest, its_role, expires)) = row.filter(|row| now < row.2) else {
        return Ok(None);
    };
    Ok(Some(Invitation {
        name: guest.as_deref().map(name).transpose()?,
        role: role(&its_role)?,
        expires,
    }))
}

/// The invitations among the records.
#[derive(Debug, Clone, Copy)]
pub struct Invitations<'r>(pub(crate) &'r Store);

impl Invitations<'_> {
    /// Keeps an invitation, by the digest of its code, to the account `name` or to one whose name is
    /// still to be chosen.
    ///
    /// # Errors
    /// [`RecordsError::Exists`] when the code is known, [`RecordsError::TooMany`].
    pub async fn add(
        self,
        name: Option<&UserName>,
        role: Role,
        code: Digest,
        expires: i64,
    ) -> Result<(), RecordsError> {
        let name = name.map(ToString::to_string);
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let (count,): (i64,) = query("SELECT count(*) FROM invitation")
                        .fetch_one(&mut *connection)
                        .await?;
                    if count >= MAX_INVITATIONS {
                        return Err(RecordsError::TooMany("invitations"));
                    }
                    let done = query(
                        "INSERT INTO invitation (digest, name, role, expires)
                         VALUES ($1, $2, $3, $4) ON CONFLICT DO NOTHING",
                    )
                    .bind(code.0.to_vec())
                    .bind(name)
                    .bind(role.to_string())
                    .bind(expires)
                    .execute(connection)
                    .await?;
                    changed(done, RecordsError::Exists)
                })
            })
            .await
    }

    /// Looks at an invitation without taking it: whoever answers it may still make mistakes.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn get(self, code: Digest, now: i64) -> Result<Option<Invitation>, RecordsError> {
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let row: Option<Invited> =
                        query("SELECT name, role, expires FROM invitation WHERE digest = $1")
                            .bind(code.0.to_vec())
                            .fetch_optional(connection)
                            .await?;
                    invited(row, now)
                })
            })
            .await
    }

    /// Takes an invitation by the digest of its code. Of several that try at once one gets it; one
    /// that has expired at `now` is gone.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be taken.
    pub async fn take(self, code: Digest, now: i64) -> Result<Option<Invitation>, RecordsError> {
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let row: Option<Invited> = query(
                        "DELETE FROM invitation WHERE digest = $1 RETURNING name, role, expires",
                    )
                    .bind(code.0.to_vec())
                    .fetch_optional(connection)
                    .await?;
                    invited(row, now)
                })
            })
            .await
    }
}
