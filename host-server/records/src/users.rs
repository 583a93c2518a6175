//! People: their accounts.

use crawler_access::{Role, UserName};

use crate::RecordsError;
use crate::account::{Row, User, find, user};
use crate::query::{Connection, changed, query};
use crate::sessions::revoke_all;
use crate::store::Store;

/// Most accounts.
pub const MAX_USERS: i64 = 10_000;
/// Longest hash of a password, in bytes.
pub const MAX_PASSWORD_HASH: usize = 512;

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

/// The accounts of people among the records.
#[derive(Debug, Clone, Copy)]
pub struct Users<'r>(pub(crate) &'r Store);

impl Users<'_> {
    /// Every account, by name.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn all(self) -> Result<Vec<User>, RecordsError> {
        self.0
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
    pub async fn get(self, name: &UserName) -> Result<Option<User>, RecordsError> {
        let name = name.to_string();
        self.0
            .read(move |connection| Box::pin(async move { find(connection, &name).await }))
            .await
    }

    /// Makes an account.
    ///
    /// # Errors
    /// [`RecordsError::Exists`], [`RecordsError::TooMany`], or [`RecordsError::Invalid`] for a hash
    /// that is too long.
    pub async fn add(self, user: &User) -> Result<(), RecordsError> {
        check_hash(user.password.as_deref())?;
        let user = user.clone();
        self.0
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
    /// [`Sessions::revoke_all`](crate::Sessions::revoke_all).
    ///
    /// # Errors
    /// [`RecordsError::NotFound`], or [`RecordsError::Invalid`] for a hash that is too long.
    pub async fn set_password(self, name: &UserName, hash: &str) -> Result<(), RecordsError> {
        check_hash(Some(hash))?;
        let (name, hash) = (name.to_string(), hash.to_owned());
        self.0
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
    pub async fn set_role(self, name: &UserName, role: Role) -> Result<(), RecordsError> {
        let name = name.to_string();
        self.0
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
        self,
        name: &UserName,
        disabled: bool,
        now: i64,
    ) -> Result<Vec<u64>, RecordsError> {
        let name = name.to_string();
        self.0
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
    pub async fn delete(self, name: &UserName, now: i64) -> Result<Vec<u64>, RecordsError> {
        let name = name.to_string();
        self.0
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
}
