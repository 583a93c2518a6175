//! Wrong passwords, however they came: over HTTP and at the broker they are counted together, so that
//! nobody has twice as many.

use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_access::UserName;
use crawler_access::limits::{Attempts, Backoff};
use crawler_system::neighbourhood;

/// Failures that count, by name and address, and by address whatever the name. Secrets of robots do
/// not: they cannot be guessed, and many robots may live behind one address.
pub struct Failures {
    names: Mutex<Attempts<(String, IpAddr)>>,
    addresses: Mutex<Attempts<IpAddr>>,
}

impl Default for Failures {
    /// Nobody has failed yet.
    fn default() -> Self {
        Self {
            names: Mutex::new(Attempts::new(Backoff::default())),
            addresses: Mutex::new(Attempts::new(Backoff {
                // A house full of people may share an address.
                free: 30,
                ..Backoff::default()
            })),
        }
    }
}

impl Failures {
    /// Whether anybody from there may try now.
    ///
    /// # Errors
    /// How long they have to wait until they may.
    pub fn check(&self, from: IpAddr, now: Instant) -> Result<(), Duration> {
        lock(&self.addresses).check(&neighbourhood(from), now)
    }

    /// Counts an attempt as failed until [`Failures::succeeded`] says otherwise.
    ///
    /// # Errors
    /// How long this name has to wait from there until it may try. Such an attempt is not counted.
    pub fn begin(
        &self,
        name: Option<&UserName>,
        from: IpAddr,
        now: Instant,
    ) -> Result<(), Duration> {
        lock(&self.names).begin(&key(name, from), now)
    }

    /// Somebody from there has failed.
    pub fn failed(&self, from: IpAddr, now: Instant) {
        lock(&self.addresses).failed(&neighbourhood(from), now);
    }

    /// This name has proven itself there.
    pub fn succeeded(&self, name: Option<&UserName>, from: IpAddr) {
        lock(&self.names).succeeded(&key(name, from));
    }
}

/// What is no name of an account has a budget of its own.
fn key(name: Option<&UserName>, from: IpAddr) -> (String, IpAddr) {
    let name = name.map_or_else(String::new, ToString::to_string);
    (name, neighbourhood(from))
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
