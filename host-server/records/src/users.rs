//! People: accounts and invitations.

use std::fmt;

use crawler_access::{Digest, Role, UserName};

use crate::query::{Connection, query};
use crate::sessions::revoke_all;
use crate::{Records, RecordsError};

/// Most accounts.
pub const MAX_USERS: i64 = 10_000;
/// Most invitations that wait to be taken.
pub const MAX_INVITATIONS: i64 = 1_000;
/// Longest hash of a password, in bytes.
pub const MAX_PASSWORD_HASH: usize = 512;

/// An account.
#[derive(Clone, PartialEq, Eq)]
pub struct User {
    /// Its name.
    pub name: UserName,
    /// What it may do.
    pub role: Role,
    /// Hash of its password; without one nobody can log in.
    pub password: Option<String>,
    /// When it was made.
    pub created: i64,
    /// Kept, but locked out.
    pub disabled: bool,
}

impl fmt::Debug for User {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("User")
            .field("name", &self.name)
            .field("role", &self.role)
            // Debug texts end up in logs, where a hash invites guessing.
            .field("password", &self.password.as_ref().map(|_| ".."))
            .field("created", &self.created)
            .field("disabled", &self.disabled)
            .finish()
    }
}

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

type Row = (String, String, Option<String>, i64, i64);
type Invited = (Option<String>, String, i64);

/// A name from the file.
pub(crate) fn name(text: &str) -> Result<UserName, RecordsError> {
    text.parse()
        .map_err(|_| RecordsError::Invalid("an invalid user name is stored"))
}

fn role(text: &str) -> Result<Role, RecordsError> {
    text.parse()
        .map_err(|_| RecordsError::Invalid("an invalid role is stored"))
}

fn user((user, its_role, password, created, disabled): Row) -> Result<User, RecordsError> {
    Ok(User {
        name: name(&user)?,
        role: role(&its_role)?,
        password,
        created,
        disabled: disabled != 0,
    })
}

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

/// The account of that name.
pub(crate) async fn find(
    connection: &mut Connection<'_>,
    name: &str,
) -> Result<Option<User>, RecordsError> {
    let row: Option<Row> =
        query("SELECT name, role, password, created, disabled FROM \"user\" WHERE name = $1")
            .bind(name)
            .fetch_optional(connection)
            .await?;
    row.map(user).transpose()
}

/// Refuses when `name` is the only one who can administer the server.
async fn not_the_last(connection: &mut Connection<'_>, name: &str) -> Result<(), RecordsError> {
    let user = find(connection, name)
        .await?
        .ok_or(RecordsError::NotFound)?;
    if user.role != Role::Admin || user.disabled || user.password.is_none() {
        return Ok(());
    }
    let (others,): (i64,) = query(
        "SELECT count(*) FROM \"user\"
         WHERE role = 'admin' AND disabled = 0 AND password IS NOT NULL AND name <> $1",
    )
    .bind(name)
    .fetch_one(connection)
    .await?;
    if others == 0 {
        return Err(RecordsError::LastAdmin);
    }
    Ok(())
}

fn check_hash(hash: Option<&str>) -> Result<(), RecordsError> {
    match hash {
        Some(hash) if hash.is_empty() || hash.len() > MAX_PASSWORD_HASH => Err(
            RecordsError::Invalid("a hash of a password has 1 to 512 bytes"),
        ),
        _ => Ok(()),
    }
}

impl Records {
    /// Every account, by name.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn users(&self) -> Result<Vec<User>, RecordsError> {
        self.db()
            .read(|connection| {
                Box::pin(async move {
                    let rows: Vec<Row> = query(
                        "SELECT name, role, password, created, disabled FROM \"user\"
                         ORDER BY name LIMIT $1",
                    )
                    .bind(MAX_USERS)
                    .fetch_all(connection)
                    .await?;
                    rows.into_iter().map(user).collect()
                })
            })
            .await
    }

    /// The account of that name.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn user(&self, name: &UserName) -> Result<Option<User>, RecordsError> {
        let name = name.to_string();
        self.db()
            .read(move |connection| Box::pin(async move { find(connection, &name).await }))
            .await
    }

    /// Makes an account.
    ///
    /// # Errors
    /// [`RecordsError::Exists`], [`RecordsError::TooMany`], or [`RecordsError::Invalid`] for a hash
    /// that is too long.
    pub async fn add_user(&self, user: &User) -> Result<(), RecordsError> {
        check_hash(user.password.as_deref())?;
        let user = user.clone();
        self.db()
            .write(move |connection| {
                Box::pin(async move {
                    let (count,): (i64,) = query("SELECT count(*) FROM \"user\"")
                        .fetch_one(&mut *connection)
                        .await?;
                    if count >= MAX_USERS {
                        return Err(RecordsError::TooMany("accounts"));
                    }
                    let done = query(
                        "INSERT INTO \"user\" (name, role, password, created, disabled)
                         VALUES ($1, $2, $3, $4, $5) ON CONFLICT DO NOTHING",
                    )
                    .bind(user.name.to_string())
                    .bind(user.role.to_string())
                    .bind(user.password)
                    .bind(user.created)
                    .bind(user.disabled)
                    .execute(connection)
                    .await?;
                    changed(done, RecordsError::Exists)
                })
            })
            .await
    }

    /// Gives an account another password, by its hash. Sessions go on: end them with
    /// [`Records::revoke_sessions`].
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], or [`RecordsError::Invalid`] for a hash that is too long.
    pub async fn set_password(&self, name: &UserName, hash: &str) -> Result<(), RecordsError> {
        check_hash(Some(hash))?;
        let (name, hash) = (name.to_string(), hash.to_owned());
        self.db()
            .write(move |connection| {
                Box::pin(async move {
                    let done = query("UPDATE \"user\" SET password = $1 WHERE name = $2")
                        .bind(hash)
                        .bind(name)
                        .execute(connection)
                        .await?;
                    changed(done, RecordsError::NotFound)
                })
            })
            .await
    }

    /// Gives an account another role.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], [`RecordsError::LastAdmin`].
    pub async fn set_role(&self, name: &UserName, role: Role) -> Result<(), RecordsError> {
        let name = name.to_string();
        self.db()
            .write(move |connection| {
                Box::pin(async move {
                    if role != Role::Admin {
                        not_the_last(connection, &name).await?;
                    }
                    let done = query("UPDATE \"user\" SET role = $1 WHERE name = $2")
                        .bind(role.to_string())
                        .bind(name)
                        .execute(connection)
                        .await?;
                    changed(done, RecordsError::NotFound)
                })
            })
            .await
    }

    /// Locks an account out at `now`, which ends its sessions, or lets it in again. Returns the
    /// sessions that ended.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], [`RecordsError::LastAdmin`].
    pub async fn set_disabled(
        &self,
        name: &UserName,
        disabled: bool,
        now: i64,
    ) -> Result<Vec<u64>, RecordsError> {
        let name = name.to_string();
        self.db()
            .write(move |connection| {
                Box::pin(async move {
                    if disabled {
                        not_the_last(connection, &name).await?;
                    }
                    let done = query("UPDATE \"user\" SET disabled = $1 WHERE name = $2")
                        .bind(disabled)
                        .bind(&name)
                        .execute(&mut *connection)
                        .await?;
                    changed(done, RecordsError::NotFound)?;
                    if disabled {
                        revoke_all(connection, &name, None, now).await
                    } else {
                        Ok(Vec::new())
                    }
                })
            })
            .await
    }

    /// Forgets an account at `now`, with the invitations to it, and ends its sessions, which it
    /// returns. What it did stays in the audit log.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], [`RecordsError::LastAdmin`].
    pub async fn delete_user(&self, name: &UserName, now: i64) -> Result<Vec<u64>, RecordsError> {
        let name = name.to_string();
        self.db()
            .write(move |connection| {
                Box::pin(async move {
                    not_the_last(connection, &name).await?;
                    query("DELETE FROM \"user\" WHERE name = $1")
                        .bind(&name)
                        .execute(&mut *connection)
                        .await?;
                    query("DELETE FROM invitation WHERE name = $1")
                        .bind(&name)
                        .execute(&mut *connection)
                        .await?;
                    revoke_all(connection, &name, None, now).await
                })
            })
            .await
    }

    /// Keeps an invitation, by the digest of its code, to the account `name` or to one whose name is
    /// still to be chosen.
    ///
    /// # Errors
    /// [`RecordsError::Exists`] when the code is known, [`RecordsError::TooMany`].
    pub async fn invite(
        &self,
        name: Option<&UserName>,
        role: Role,
        code: Digest,
        expires: i64,
    ) -> Result<(), RecordsError> {
        let name = name.map(ToString::to_string);
        self.db()
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
    pub async fn invitation(
        &self,
        code: Digest,
        now: i64,
    ) -> Result<Option<Invitation>, RecordsError> {
        self.db()
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
    pub async fn take_invitation(
        &self,
        code: Digest,
        now: i64,
    ) -> Result<Option<Invitation>, RecordsError> {
        self.db()
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

/// `refusal` unless a row was changed.
pub(crate) fn changed(rows: u64, refusal: RecordsError) -> Result<(), RecordsError> {
    if rows == 0 { Err(refusal) } else { Ok(()) }
}
