//! Who is logged in: sessions, and the refresh tokens that keep them going.

use crawler_access::{Digest, UserName};

use crate::RecordsError;
use crate::account::{User, find, name};
use crate::query::{Connection, changed, query};
use crate::store::Store;

/// Most sessions of one account; the oldest ends when another is opened.
pub const MAX_SESSIONS: i64 = 64;
/// Longest address that is kept with a session, in bytes; the rest is cut off.
pub const MAX_FROM: usize = 128;

/// A session that was not revoked. It may have expired: see `expires`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Session {
    /// Its number, which never comes back.
    pub id: u64,
    /// Whose it is.
    pub user: UserName,
    /// Where it was opened from.
    pub from: String,
    /// When it was opened.
    pub opened: i64,
    /// When it was last refreshed.
    pub refreshed: i64,
    /// When it ends unless it is refreshed.
    pub expires: i64,
}

/// What a refresh token was worth.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refreshed {
    /// The session goes on, with the new token and for as long again as it was opened for.
    Ok {
        /// The session.
        session: u64,
        /// Its account, as it is now.
        user: User,
    },
    /// The token was used before: somebody has a copy. The session was revoked.
    Reused {
        /// The session.
        session: u64,
        /// Whose it was.
        user: UserName,
    },
    /// No such token; or its session has ended, or its account is locked out or gone.
    Unknown,
}

type Row = (i64, String, String, i64, i64, i64);

fn session((id, user, from, opened, refreshed, expires): Row) -> Result<Session, RecordsError> {
    Ok(Session {
        id: id as u64,
        user: name(&user)?,
        from,
        opened,
        refreshed,
        expires,
    })
}

/// Revokes the sessions of `user`, all but one of them where `but` names it.
pub(crate) async fn revoke_all(
    connection: &mut Connection<'_>,
    user: &str,
    but: Option<u64>,
    now: i64,
) -> Result<Vec<u64>, RecordsError> {
    let rows: Vec<(i64,)> = query(
        "UPDATE session SET revoked = $1
         WHERE \"user\" = $2 AND revoked IS NULL AND id IS DISTINCT FROM $3 RETURNING id",
    )
    .bind(now)
    .bind(user)
    .bind(but.map(|id| id as i64))
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().map(|(id,)| id as u64).collect())
}

async fn keep_digest(
    connection: &mut Connection<'_>,
    digest: Digest,
    session: i64,
) -> Result<(), RecordsError> {
    let done = query(
        "INSERT INTO refresh (digest, session, used) VALUES ($1, $2, NULL) ON CONFLICT DO NOTHING",
    )
    .bind(digest.0.to_vec())
    .bind(session)
    .execute(connection)
    .await?;
    changed(done, RecordsError::Exists)
}

/// The sessions among the records.
#[derive(Debug, Clone, Copy)]
pub struct Sessions<'r>(pub(crate) &'r Store);

impl Sessions<'_> {
    /// Opens a session of an account, from `now` until `expires`, that `refresh` prolongs. Returns
    /// its number.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when there is no such account or it is locked out,
    /// [`RecordsError::Exists`] when the token is known.
    pub async fn open(
        self,
        user: &UserName,
        refresh: Digest,
        now: i64,
        expires: i64,
        from: &str,
    ) -> Result<u64, RecordsError> {
        if expires <= now {
            return Err(RecordsError::Invalid("a session lasts some time"));
        }
        let user = user.to_string();
        let from = crate::text::cut(from, MAX_FROM);
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    match find(connection, &user).await? {
                        Some(user) if !user.disabled => {}
                        _ => return Err(RecordsError::NotFound),
                    }
                    query(
                        "UPDATE session SET revoked = $1
                         WHERE \"user\" = $2 AND revoked IS NULL AND id NOT IN
                         (SELECT id FROM session WHERE \"user\" = $2 AND revoked IS NULL
                          ORDER BY id DESC LIMIT $3)",
                    )
                    .bind(now)
                    .bind(&user)
                    .bind(MAX_SESSIONS - 1)
                    .execute(&mut *connection)
                    .await?;
                    let (id,): (i64,) = query(
                        "INSERT INTO session (\"user\", came_from, opened, refreshed, expires)
                         VALUES ($1, $2, $3, $3, $4) RETURNING id",
                    )
                    .bind(user)
                    .bind(from)
                    .bind(now)
                    .bind(expires)
                    .fetch_one(&mut *connection)
                    .await?;
                    keep_digest(connection, refresh, id).await?;
                    Ok(id as u64)
                })
            })
            .await
    }

    /// Exchanges a refresh token for another one, by their digests. A token that was exchanged
    /// before ends its session: of two that hold it, one is a thief.
    ///
    /// # Errors
    /// [`RecordsError::Exists`] when the new token is known.
    pub async fn refresh(
        self,
        old: Digest,
        new: Digest,
        now: i64,
    ) -> Result<Refreshed, RecordsError> {
        self.0
            .write(move |connection| Box::pin(refresh(connection, old, new, now)))
            .await
    }

    /// The sessions that were not revoked, of one account or of all, newest first.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn all(self, user: Option<&UserName>) -> Result<Vec<Session>, RecordsError> {
        let user = user.map(ToString::to_string);
        self.0
            .read(|connection| {
                Box::pin(async move {
                    let rows: Vec<Row> = query(
                        "SELECT id, \"user\", came_from, opened, refreshed, expires FROM session
                         WHERE revoked IS NULL AND ($1 IS NULL OR \"user\" = $1)
                         ORDER BY id DESC LIMIT 10000",
                    )
                    .bind(user)
                    .fetch_all(connection)
                    .await?;
                    rows.into_iter().map(session).collect()
                })
            })
            .await
    }

    /// Numbers of the sessions that were revoked at `since` or later: what a server that starts must
    /// not accept a token of.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn revoked_since(self, since: i64) -> Result<Vec<u64>, RecordsError> {
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let rows: Vec<(i64,)> = query(
                        "SELECT id FROM session WHERE revoked IS NOT NULL AND revoked >= $1
                         ORDER BY id",
                    )
                    .bind(since)
                    .fetch_all(connection)
                    .await?;
                    Ok(rows.into_iter().map(|(id,)| id as u64).collect())
                })
            })
            .await
    }

    /// Ends a session.
    ///
    /// # Errors
    /// [`RecordsError::NotFound`] when there is none of that number, or it has ended before.
    pub async fn revoke(self, session: u64, now: i64) -> Result<(), RecordsError> {
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let done =
                        query("UPDATE session SET revoked = $1 WHERE id = $2 AND revoked IS NULL")
                            .bind(now)
                            .bind(session as i64)
                            .execute(connection)
                            .await?;
                    changed(done, RecordsError::NotFound)
                })
            })
            .await
    }

    /// Ends the sessions of an account, all but `but`, and returns those that ended.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be ended.
    pub async fn revoke_all(
        self,
        user: &UserName,
        but: Option<u64>,
        now: i64,
    ) -> Result<Vec<u64>, RecordsError> {
        let user = user.to_string();
        self.0
            .write(move |connection| {
                Box::pin(async move { revoke_all(connection, &user, but, now).await })
            })
            .await
    }
}

async fn refresh(
    connection: &mut Connection<'_>,
    old: Digest,
    new: Digest,
    now: i64,
) -> Result<Refreshed, RecordsError> {
    type Found = (i64, Option<i64>, String, i64, i64, Option<i64>);
    let found: Option<Found> = query(
        "SELECT s.id, r.used, s.\"user\", s.refreshed, s.expires, s.revoked
         FROM refresh AS r JOIN session AS s ON s.id = r.session WHERE r.digest = $1",
    )
    .bind(old.0.to_vec())
    .fetch_optional(&mut *connection)
    .await?;
    let Some((id, used, user, refreshed, expires, revoked)) = found else {
        return Ok(Refreshed::Unknown);
    };
    if revoked.is_some() {
        return Ok(Refreshed::Unknown);
    }
    if used.is_some() {
        query("UPDATE session SET revoked = $1 WHERE id = $2")
            .bind(now)
            .bind(id)
            .execute(connection)
            .await?;
        return Ok(Refreshed::Reused {
            session: id as u64,
            user: name(&user)?,
        });
    }
    let account = find(connection, &user).await?;
    let Some(user) = account.filter(|user| !user.disabled && now < expires) else {
        return Ok(Refreshed::Unknown);
    };
    query("UPDATE refresh SET used = $1 WHERE digest = $2")
        .bind(now)
        .bind(old.0.to_vec())
        .execute(&mut *connection)
        .await?;
    keep_digest(connection, new, id).await?;
    let lasts = expires.saturating_sub(refreshed);
    // A copy of a token is worth watching for as long as the token would have been worth something.
    query("DELETE FROM refresh WHERE session = $1 AND used < $2")
        .bind(id)
        .bind(now.saturating_sub(lasts))
        .execute(&mut *connection)
        .await?;
    query("UPDATE session SET refreshed = $1, expires = $2 WHERE id = $3")
        .bind(now)
        .bind(now.saturating_add(lasts))
        .bind(id)
        .execute(connection)
        .await?;
    Ok(Refreshed::Ok {
        session: id as u64,
        user,
    })
}
