//! What several servers of one fleet share, in Redis.
//!
//! Every server holds a lease ([`Cluster::join`], [`Cluster::renew`]). Commands that robots are owed
//! belong to one server at a time ([`Cluster::accept`]); when its lease is over another takes them
//! ([`Cluster::adopt`]), in one atomic step. Whoever comes back after that learns it from
//! [`Cluster::join`]. What a server hears of robots it passes on in [frames](frame).
//!
//! Scripts run in Redis are atomic, and every one that writes for a server checks its lease first: a
//! server that was stopped for longer than its lease changes nothing any more.
//!
//! What one of several servers knows of its own place among them is its [`ClusterMembership`].
//!
//! This crate knows nothing of commands and robots: what it keeps for its caller is text.

pub mod frame;
mod journal;
mod lease;
mod membership;
mod number;
mod queue;
mod share;

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures_util::StreamExt as _;
use redis::aio::{ConnectionManager, ConnectionManagerConfig, PubSubStream};
use redis::{Client, RedisError};

pub use journal::{Fields, HEAD};
pub use lease::{Adopted, Joined, LEASE, RENEW, Renewed, SLOTS};
pub use membership::{ClusterMembership, Counts};
pub use number::{LONGEST_BLOCK, Numbers, TICKS_PER_MS};
pub use queue::{MOST_BYTES, Queue};
pub use share::{Bucket, Spent};

/// For one answer of Redis, and for a connection to it.
const ANSWER: Duration = Duration::from_secs(1);
/// Between two attempts to connect.
const PAUSE: Duration = Duration::from_millis(500);

/// Why something cannot be shared.
#[derive(Debug)]
#[non_exhaustive]
pub enum ClusterError {
    /// The address cannot be used.
    Address(String),
    /// Redis does not answer, or not as it should. Whether it has done what it was asked is open.
    Away(RedisError),
    /// This server has no lease: another may have taken what was its own. Nothing has changed.
    NoLease,
    /// The system gives no random numbers.
    NoRandomness,
}

impl fmt::Display for ClusterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(text) => write!(f, "the address is of no use: {text}"),
            Self::Away(error) => error.fmt(f),
            Self::NoLease => f.write_str("this server has no lease"),
            Self::NoRandomness => f.write_str("the system gives no random numbers"),
        }
    }
}

impl std::error::Error for ClusterError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Away(error) => Some(error),
            _ => None,
        }
    }
}

impl From<RedisError> for ClusterError {
    fn from(error: RedisError) -> Self {
        Self::Away(error)
    }
}

/// What came over a [`Subscription`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum News {
    /// A frame of what another server has heard.
    Heard(Vec<u8>),
    /// Another server has changed something in the records.
    Changed,
}

/// One server's part of what is shared.
pub struct Cluster {
    client: Client,
    connection: ConnectionManager,
    prefix: String,
    /// Of this process alone: two servers with one name, from a copied folder, differ in it.
    token: String,
    /// The name that what it is owed is kept under.
    instance: Mutex<String>,
    up: AtomicBool,
}

impl fmt::Debug for Cluster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The client would show the password.
        f.debug_struct("Cluster")
            .field("prefix", &self.prefix)
            .field("instance", &self.instance())
            .finish_non_exhaustive()
    }
}

impl Cluster {
    /// The part of the server `instance` in what servers of `fleet` share at `url`. Connects with
    /// the first call that needs it.
    ///
    /// # Errors
    /// [`ClusterError::Address`] and [`ClusterError::NoRandomness`].
    pub fn open(url: &str, fleet: &str, instance: String) -> Result<Self, ClusterError> {
        let bad = |error: RedisError| ClusterError::Address(error.to_string());
        let client = Client::open(url).map_err(bad)?;
        let config = ConnectionManagerConfig::new()
            .set_connection_timeout(Some(ANSWER))
            .set_response_timeout(Some(ANSWER))
            .set_number_of_retries(1)
            .set_max_delay(PAUSE);
        let connection = ConnectionManager::new_lazy_with_config(client.clone(), config);
        Ok(Self {
            client,
            connection: connection.map_err(bad)?,
            // The braces keep the keys of a fleet together where Redis is a cluster.
            prefix: format!("terracrawler:{{{fleet}}}:"),
            token: random()?,
            instance: Mutex::new(instance),
            up: AtomicBool::new(false),
        })
    }

    /// A name for a server that has none.
    ///
    /// # Errors
    /// [`ClusterError::NoRandomness`].
    pub fn new_name() -> Result<String, ClusterError> {
        random()
    }

    /// The name that what this server owes is kept under.
    #[must_use]
    pub fn instance(&self) -> String {
        self.name().clone()
    }

    /// Goes on under another name: what was kept under the old one is another server's.
    pub fn rename(&self, instance: String) {
        *self.name() = instance;
    }

    /// Whether Redis answered when it was last asked.
    #[must_use]
    pub fn is_up(&self) -> bool {
        self.up.load(Ordering::Relaxed)
    }

    fn name(&self) -> MutexGuard<'_, String> {
        self.instance.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn key(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    fn noted<T>(&self, result: Result<T, RedisError>) -> Result<T, ClusterError> {
        self.up.store(result.is_ok(), Ordering::Relaxed);
        Ok(result?)
    }

    /// Passes a frame on to the other servers.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn tell(&self, frame: &[u8]) -> Result<(), ClusterError> {
        self.publish("heard", frame).await
    }

    /// Tells the other servers that something has changed in the records.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn changed(&self) -> Result<(), ClusterError> {
        self.publish("changed", self.token.as_bytes()).await
    }

    async fn publish(&self, channel: &str, message: &[u8]) -> Result<(), ClusterError> {
        let mut command = redis::cmd("PUBLISH");
        command.arg(self.key(channel)).arg(message);
        let sent: Result<(), _> = command.query_async(&mut self.connection.clone()).await;
        self.noted(sent)
    }

    /// The name of this process in frames that it sends.
    #[must_use]
    pub fn token(&self) -> &str {
        &self.token
    }

    /// Listens to the other servers.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn subscribe(&self) -> Result<Subscription, ClusterError> {
        let connecting = async {
            let mut subscription = self.client.get_async_pubsub().await?;
            for channel in ["heard", "changed"] {
                subscription.subscribe(self.key(channel)).await?;
            }
            Ok::<_, RedisError>(subscription.into_on_message())
        };
        let silent = |_| RedisError::from(std::io::Error::from(std::io::ErrorKind::TimedOut));
        let connected = tokio::time::timeout(ANSWER, connecting).await;
        Ok(Subscription {
            messages: connected.map_err(silent)??,
            changed: self.key("changed"),
            token: self.token.clone(),
        })
    }
}

/// What other servers tell, from [`Cluster::subscribe`].
pub struct Subscription {
    messages: PubSubStream,
    changed: String,
    token: String,
}

impl Subscription {
    /// The next; `None` when the connection is lost.
    ///
    /// # Cancellation safety
    /// Nothing is lost.
    pub async fn next(&mut self) -> Option<News> {
        loop {
            let message = self.messages.next().await?;
            let payload = message.get_payload_bytes();
            if message.get_channel_name() != self.changed {
                return Some(News::Heard(payload.to_vec()));
            }
            if payload != self.token.as_bytes() {
                return Some(News::Changed);
            }
        }
    }
}

/// Eight random bytes, as text.
fn random() -> Result<String, ClusterError> {
    use fmt::Write as _;
    let mut bytes = [0_u8; 8];
    getrandom::fill(&mut bytes).map_err(|_| ClusterError::NoRandomness)?;
    Ok(bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    }))
}
