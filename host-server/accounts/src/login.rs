//! Getting in: by password, by refresh token, by invitation.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use crawler_access::password::{self, HashError, Weak};
use crawler_access::{Digest, Role, Secret, UserName};
use crawler_records::{RecordsError, Refreshed, User};

use crate::{Accounts, Identity, SESSION_LIFETIME, lock};
use crawler_passwords::Busy;
use crawler_system::clock::now_ms;

/// Two pages of one browser may use the same refresh token at the same moment. The second is not a
/// thief when it comes this soon after the first; it gets no refresh token of its own.
const GRACE: Duration = Duration::from_secs(2);
/// Refresh tokens remembered for that.
const MOST_ROTATED: usize = 1_024;

/// What somebody has who got in.
pub struct Entered {
    /// The access token.
    pub token: String,
    /// For how many seconds it is good.
    pub expires_in: i64,
    /// The account.
    pub user: UserName,
    /// What it may do.
    pub role: Role,
    /// The session.
    pub session: u64,
    /// The next refresh token, where there is one.
    pub refresh: Option<Secret>,
}

/// Why somebody does not get in.
#[derive(Debug)]
pub enum LoginError {
    /// Name or password are wrong, or the account is locked: which one is nobody's business.
    Credentials,
    /// Too many failures; this long until the next attempt.
    Wait(Duration),
    /// There is no session to this refresh token.
    NoSession,
    /// The refresh token was used before. Its session has been ended.
    Reused {
        /// The session.
        session: u64,
        /// Whose it was.
        user: UserName,
    },
    /// There is no such invitation, or no longer.
    Invitation,
    /// The invitation leaves the name open and none was given, or it cannot be one.
    Name,
    /// There is an account of that name.
    Exists,
    /// The password is not good enough.
    Weak(Weak),
    /// Too many passwords are being checked.
    Busy,
    /// The records cannot be used.
    Records(RecordsError),
    /// Something that cannot happen did.
    Internal(&'static str),
}

impl From<RecordsError> for LoginError {
    fn from(error: RecordsError) -> Self {
        match error {
            RecordsError::Exists => Self::Exists,
            error => Self::Records(error),
        }
    }
}

impl From<Busy> for LoginError {
    fn from(_: Busy) -> Self {
        Self::Busy
    }
}

impl From<HashError> for LoginError {
    fn from(error: HashError) -> Self {
        match error {
            HashError::TooLong => Self::Weak(Weak::TooLong),
            _ => Self::Internal("a password could not be hashed"),
        }
    }
}

/// Refresh tokens that were used a moment ago.
#[derive(Default)]
pub(crate) struct Rotated(VecDeque<(Digest, u64, Instant)>);

impl Rotated {
    fn note(&mut self, digest: Digest, session: u64, now: Instant) {
        if self.0.len() >= MOST_ROTATED {
            self.0.pop_front();
        }
        self.0.push_back((digest, session, now));
    }

    fn session(&mut self, digest: Digest, now: Instant) -> Option<u64> {
        let old = |at: &Instant| now.saturating_duration_since(*at) > GRACE;
        while self.0.front().is_some_and(|(.., at)| old(at)) {
            self.0.pop_front();
        }
        let mut all = self.0.iter();
        all.find(|(known, ..)| *known == digest)
            .map(|(_, session, _)| *session)
    }
}

impl Accounts {
    /// Opens a session for whoever knows the password.
    ///
    /// # Errors
    /// [`LoginError`] says why nobody gets in.
    pub async fn login(
        &self,
        name: &str,
        password: String,
        from: IpAddr,
    ) -> Result<Entered, LoginError> {
        let name = name.parse::<UserName>().ok();
        let now = Instant::now();
        self.failures
            .check(from, now)
            .and_then(|()| self.failures.begin(name.as_ref(), from, now))
            .map_err(LoginError::Wait)?;
        let user = match &name {
            Some(name) => self.records.users().get(name).await?,
            None => None,
        };
        let hash = user.as_ref().and_then(|user| user.password.clone());
        let good = self
            .hashing
            .run(move |memory| {
                if let Some(hash) = hash {
                    return memory.verify(&password, &hash);
                }
                // As long as for a name that exists.
                memory.verify_nobody(&password);
                false
            })
            .await?;
        match user {
            Some(user) if good && !user.disabled => {
                self.failures.succeeded(name.as_ref(), from);
                self.enter(&user, from).await
            }
            _ => {
                self.failures.failed(from, Instant::now());
                Err(LoginError::Credentials)
            }
        }
    }

    /// Opens a session for a user who has proven to be that.
    pub(crate) async fn enter(&self, user: &User, from: IpAddr) -> Result<Entered, LoginError> {
        let refresh = new_secret()?;
        let now = now_ms();
        let expires = now.saturating_add(SESSION_LIFETIME.as_millis() as i64);
        let session = self
            .records
            .sessions()
            .open(
                &user.name,
                refresh.digest(),
                now,
                expires,
                &from.to_string(),
            )
            .await;
        let session = match session {
            // Deleted or locked out while the password was being checked.
            Err(RecordsError::NotFound) => return Err(LoginError::Credentials),
            session => session?,
        };
        lock(&self.alive).insert(session, &user.name, expires);
        // Whoever changed the account in between has ended all sessions but this one.
        let still = self.records.users().get(&user.name).await?;
        if still.as_ref() != Some(user) {
            self.end_session(session).await?;
            return Err(LoginError::Credentials);
        }
        Ok(self.entered(user, session, Some(refresh)))
    }

    fn entered(&self, user: &User, session: u64, refresh: Option<Secret>) -> Entered {
        let (token, expires_in) = self.token(&user.name, user.role, session);
        Entered {
            token,
            expires_in,
            user: user.name.clone(),
            role: user.role,
            session,
            refresh,
        }
    }

    /// Gives a new access token, and a new refresh token, for one that was not used yet.
    ///
    /// # Errors
    /// [`LoginError`] says why the session does not go on.
    pub async fn refresh(&self, refresh: &str) -> Result<Entered, LoginError> {
        let old: Secret = refresh.parse().map_err(|_| LoginError::NoSession)?;
        let digest = old.digest();
        // Of two that come at once the second waits for the first, and is known for what it is.
        let turn = usize::from(digest.0[0]) % self.refreshing.len();
        let _refreshing = self.refreshing[turn].lock().await;
        let again = lock(&self.rotated).session(digest, Instant::now());
        if let Some(session) = again {
            return self.again(session).await;
        }
        let next = new_secret()?;
        let now = now_ms();
        match self
            .records
            .sessions()
            .refresh(digest, next.digest(), now)
            .await?
        {
            Refreshed::Ok { session, user } => {
                lock(&self.rotated).note(digest, session, Instant::now());
                let expires = now.saturating_add(SESSION_LIFETIME.as_millis() as i64);
                lock(&self.alive).insert(session, &user.name, expires);
                Ok(self.entered(&user, session, Some(next)))
            }
            Refreshed::Reused { session, user } => {
                lock(&self.alive).end(session, now);
                Err(LoginError::Reused { session, user })
            }
            Refreshed::Unknown => Err(LoginError::NoSession),
        }
    }

    /// The second of two pages that refreshed at the same moment.
    async fn again(&self, session: u64) -> Result<Entered, LoginError> {
        let name = {
            let alive = lock(&self.alive);
            alive.get(session, now_ms()).map(|(user, _)| user.clone())
        };
        let name = name.ok_or(LoginError::NoSession)?;
        let user = self.records.users().get(&name).await?;
        let user = user
            .filter(|user| !user.disabled)
            .ok_or(LoginError::NoSession)?;
        Ok(self.entered(&user, session, None))
    }

    /// Ends the session of a refresh token; returns whose it was.
    ///
    /// # Errors
    /// [`LoginError`] of the records.
    pub async fn leave(&self, refresh: &str) -> Result<Option<(UserName, u64)>, LoginError> {
        let Ok(old) = refresh.parse::<Secret>() else {
            return Ok(None);
        };
        let next = new_secret()?;
        let refreshed = self
            .records
            .sessions()
            .refresh(old.digest(), next.digest(), now_ms())
            .await?;
        match refreshed {
            Refreshed::Ok { session, user } => {
                self.end_session(session).await?;
                Ok(Some((user.name, session)))
            }
            Refreshed::Reused { session, user } => {
                lock(&self.alive).end(session, now_ms());
                Ok(Some((user, session)))
            }
            Refreshed::Unknown => Ok(None),
        }
    }

    /// Changes the password of whoever knows the old one, and ends their other sessions.
    ///
    /// # Errors
    /// [`LoginError`] says why the old one stays.
    pub async fn change_password(
        &self,
        identity: &Identity,
        old: String,
        new: String,
        from: IpAddr,
    ) -> Result<(), LoginError> {
        password::check(&identity.user, &new).map_err(LoginError::Weak)?;
        // A token that was stolen is not to be good for guessing the password.
        let name = Some(&identity.user);
        self.failures
            .begin(name, from, Instant::now())
            .map_err(LoginError::Wait)?;
        let user = self.records.users().get(&identity.user).await?;
        let hash = user
            .and_then(|user| user.password)
            .ok_or(LoginError::Credentials)?;
        let hashed = self
            .hashing
            .run(move |memory| memory.verify(&old, &hash).then(|| memory.hash(&new)))
            .await?
            .ok_or(LoginError::Credentials)??;
        self.failures.succeeded(name, from);
        self.records
            .users()
            .set_password(&identity.user, &hashed)
            .await?;
        self.end_sessions(&identity.user, Some(identity.session))
            .await?;
        Ok(())
    }
}

pub(crate) fn new_secret() -> Result<Secret, LoginError> {
    Secret::generate().map_err(|_| LoginError::Internal("no randomness"))
}
