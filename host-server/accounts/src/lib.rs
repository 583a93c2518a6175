//! Accounts of people: who somebody is, and what they have to show for it.
//!
//! A password opens a session; the session's refresh token, which rotates, gets access tokens that
//! last a quarter of an hour. What must survive a restart is in the records; what every request asks
//! is in memory.
//!
//! - [`Accounts`]: logging in, sessions, tickets for sockets, invitations, and the people themselves.
//!
//! The rules are `crawler-access`'s, checking passwords `crawler-passwords`'; here is who has logged in.
//!
//! Reading order: `login`; `sessions`, `tickets` and `invitations`; `people`.

mod invitations;
mod login;
mod people;
mod sessions;
mod tickets;

use std::collections::HashSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_access::token::{Claims, Key, TokenError};
use crawler_access::{Digest, Role, Secret, UserName};
use crawler_cluster::Cluster;
use crawler_passwords::{Failures, Hashing};
use crawler_records::{Records, RecordsError};
use tokio_util::sync::CancellationToken;

use crawler_system::clock::now_ms;
use crawler_system::text::hex;
use login::Rotated;
use sessions::Alive;
use tickets::Tickets;

pub use login::{Entered, LoginError};
pub use people::{Change, PeopleError, UserView};
pub use sessions::Ending;
pub use tickets::LIFETIME as TICKET_LIFETIME;

/// Name of the key that signs tokens, in the records.
const KEY: &str = "token_key";
/// For how long a session lasts that nobody refreshes.
pub const SESSION_LIFETIME: Duration = Duration::from_hours(14 * 24);
/// For a place among the passwords that are checked. Whoever waits at the broker holds one of its places for
/// handshakes, and robots need those.
const AT_API: Duration = Duration::from_secs(5);
const AT_BROKER: Duration = Duration::from_secs(3);
/// Refresh tokens exchanged at a time, at most.
const REFRESHING: usize = 64;

/// Somebody who has shown who they are.
#[derive(Debug, Clone)]
pub struct Identity {
    /// The account.
    pub user: UserName,
    /// What it may do.
    pub role: Role,
    /// The session.
    pub session: u64,
    /// Ends with the session.
    pub ended: CancellationToken,
}

/// Why a token names nobody.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AuthError {
    /// It was good once.
    Expired,
    /// It never was, or its session is over.
    Unknown,
}

/// All accounts of this server.
pub struct Accounts {
    open: bool,
    records: Records,
    key: Key,
    alive: Mutex<Alive>,
    tickets: Mutex<Tickets>,
    rotated: Mutex<Rotated>,
    /// One is held while a refresh token is exchanged, until that is noted in `rotated`. Which one, its
    /// digest says: while the records are slow, few people wait for each other.
    refreshing: [tokio::sync::Mutex<()>; REFRESHING],
    /// Wrong passwords, also those at the broker.
    failures: Arc<Failures>,
    hashing: Hashing,
    /// Held while accounts change, so that what was checked still holds when it is written.
    changing: tokio::sync::Mutex<()>,
    /// The invitation of the first administrator, and until when it is good.
    first: Mutex<Option<(Digest, Instant)>>,
}

/// Why there are no accounts.
#[derive(Debug)]
pub enum OpenError {
    /// The records cannot be read or written.
    Records(RecordsError),
    /// The system gives no random numbers.
    NoRandomness,
    /// What is kept as the key of tokens is none.
    Key,
}

impl From<RecordsError> for OpenError {
    fn from(error: RecordsError) -> Self {
        Self::Records(error)
    }
}

impl Accounts {
    /// The accounts in `records`. On an `open` server, nobody needs one.
    ///
    /// # Errors
    /// [`OpenError`] says why there are none.
    pub async fn open(records: Records, open: bool) -> Result<Self, OpenError> {
        let new = Secret::generate().map_err(|_| OpenError::NoRandomness)?;
        let kept = records.settings().get_or_set(KEY, new.as_bytes()).await?;
        let kept = <[u8; 32]>::try_from(kept).map_err(|_| OpenError::Key)?;
        let accounts = Self {
            open,
            records,
            key: Key::from_secret(Secret::from(kept)),
            alive: Mutex::default(),
            tickets: Mutex::default(),
            rotated: Mutex::default(),
            refreshing: std::array::from_fn(|_| tokio::sync::Mutex::default()),
            failures: Arc::new(Failures::default()),
            hashing: Hashing::new(AT_API),
            changing: tokio::sync::Mutex::new(()),
            first: Mutex::default(),
        };
        accounts.catch_up().await?;
        Ok(accounts)
    }

    /// Wrong passwords, for whoever checks some elsewhere.
    pub fn failures(&self) -> Arc<Failures> {
        Arc::clone(&self.failures)
    }

    /// The places at which passwords are checked that come to the broker.
    pub fn hashing_at_broker(&self) -> Hashing {
        self.hashing.other(AT_BROKER)
    }

    /// Whether everybody who reaches the server may do everything.
    pub const fn is_open(&self) -> bool {
        self.open
    }

    /// Whose token this is.
    ///
    /// # Errors
    /// [`AuthError`] when it names nobody.
    pub fn who(&self, token: &str) -> Result<Identity, AuthError> {
        let now = now_ms();
        let claims =
            self.key
                .verify(token, now.div_euclid(1_000))
                .map_err(|error| match error {
                    TokenError::Expired => AuthError::Expired,
                    _ => AuthError::Unknown,
                })?;
        let alive = lock(&self.alive);
        let (user, ended) = alive.get(claims.session, now).ok_or(AuthError::Unknown)?;
        if *user != claims.user {
            // Numbers of sessions are used once, so this is another database than the token's.
            return Err(AuthError::Unknown);
        }
        Ok(Identity {
            user: claims.user,
            role: claims.role,
            session: claims.session,
            ended,
        })
    }

    /// A token for a session, and for how many seconds it is good.
    fn token(&self, user: &UserName, role: Role, session: u64) -> (String, i64) {
        let now = now_ms().div_euclid(1_000);
        let lifetime = crawler_access::token::LIFETIME;
        let claims = Claims {
            user: user.clone(),
            role,
            session,
            issued: now,
            expires: now + lifetime,
        };
        (self.key.sign(&claims), lifetime)
    }

    /// A ticket for the live feed; `None` when the system gives no random numbers.
    pub fn ticket(&self, identity: &Identity) -> Option<Secret> {
        lock(&self.tickets).issue(identity, Instant::now()).ok()
    }

    /// Whose ticket this is. It is used up by that.
    pub fn redeem(&self, ticket: &str) -> Option<Identity> {
        let secret = ticket.parse().ok()?;
        let identity = lock(&self.tickets).redeem(&secret, Instant::now())?;
        // The session may have ended since.
        (!identity.ended.is_cancelled()).then_some(identity)
    }

    /// A ticket that any of several servers takes.
    pub async fn shared_ticket(&self, identity: &Identity, cluster: &Cluster) -> Option<Secret> {
        // Also here, for as long as Redis is away.
        let ticket = self.ticket(identity)?;
        let lent = tickets::SharedTicket::of(identity);
        let name = hex(&ticket.digest().0);
        let told = cluster.lend(&name, &lent, TICKET_LIFETIME).await;
        if let Err(error) = told {
            tracing::warn!(%error, "a ticket is good on this server alone");
        }
        Some(ticket)
    }

    /// Whose ticket this is, whichever server gave it. It is used up by that.
    pub async fn redeem_shared(&self, ticket: &str, cluster: &Cluster) -> Option<Identity> {
        let secret: Secret = ticket.parse().ok()?;
        let own = lock(&self.tickets).redeem(&secret, Instant::now());
        match cluster.redeem(&hex(&secret.digest().0)).await {
            Ok(lent) => {
                let (session, role) = tickets::SharedTicket::read(&lent?)?;
                let alive = lock(&self.alive);
                let (user, ended) = alive.get(session, now_ms())?;
                Some(Identity {
                    user: user.clone(),
                    role,
                    session,
                    ended,
                })
            }
            Err(_) => own,
        }
        .filter(|identity| !identity.ended.is_cancelled())
    }

    /// Why a session that has ended did so.
    pub fn ending(&self, session: u64) -> Ending {
        lock(&self.alive).ending(session)
    }

    /// Ends a session: its tokens are worth nothing from here on. Whether it was alive.
    ///
    /// # Errors
    /// [`RecordsError`] when the records do not know of it yet.
    pub async fn end_session(&self, session: u64) -> Result<bool, RecordsError> {
        // Memory first: whatever the disk does, nobody goes on with it.
        let now = now_ms();
        lock(&self.alive).end(session, now);
        match self.records.sessions().revoke(session, now).await {
            Ok(()) => Ok(true),
            Err(RecordsError::NotFound) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Ends all sessions of a user, or all but one.
    async fn end_sessions(&self, user: &UserName, but: Option<u64>) -> Result<(), RecordsError> {
        let now = now_ms();
        lock(&self.alive).end_all(user, but, now);
        let ended = self.records.sessions().revoke_all(user, but, now).await?;
        let mut alive = lock(&self.alive);
        for session in ended {
            alive.end(session, now);
        }
        Ok(())
    }

    /// The sessions that are alive, of one user or of all.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn sessions(
        &self,
        user: Option<&UserName>,
    ) -> Result<Vec<crawler_records::Session>, RecordsError> {
        let now = now_ms();
        let mut sessions = self.records.sessions().all(user).await?;
        sessions.retain(|session| session.expires > now);
        Ok(sessions)
    }

    /// Takes in what the records say of sessions: those of an earlier start, and what another
    /// process, such as the console, has ended.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn catch_up(&self) -> Result<(), RecordsError> {
        // Sessions that are opened from here on may be missing from what is read.
        let before = lock(&self.alive).ids();
        let known = self.records.sessions().all(None).await?;
        let now = now_ms();
        let mut alive = lock(&self.alive);
        for session in &known {
            if session.expires > now {
                alive.insert(session.id, &session.user, session.expires);
            }
        }
        let known: HashSet<u64> = known.iter().map(|session| session.id).collect();
        for id in before {
            if !known.contains(&id) {
                alive.end(id, now);
            }
        }
        alive.sweep(now);
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
