//! How many requests one address and one user may make.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use crawler_access::UserName;
use crawler_access::limits::{Allowance, Flood, Verdict, neighbourhood};
use crawler_cluster::{Bucket, Spent};

use super::problem::Problem;
use crate::cluster::Together;

/// For one address, which a house full of people may share.
const ADDRESS: Allowance = Allowance {
    per_second: 200.0,
    burst: 1_000.0,
    debt: 0.0,
    patience: Duration::ZERO,
};
/// For one user. Steering makes ten requests a second, a page that opens some fifty at once.
const USER: Allowance = Allowance {
    per_second: 50.0,
    burst: 300.0,
    debt: 0.0,
    patience: Duration::ZERO,
};
/// Addresses, and users, that are remembered.
const MOST: usize = 8_192;

/// What one may do, by who it is.
struct Buckets<K> {
    allowance: Allowance,
    buckets: HashMap<K, (Flood, Instant)>,
}

impl<K: Hash + Eq> Buckets<K> {
    fn new(allowance: Allowance) -> Self {
        Self {
            allowance,
            buckets: HashMap::new(),
        }
    }

    /// Takes one request out of `key`'s bucket.
    fn spend(&mut self, key: K, now: Instant) -> bool {
        if self.buckets.len() >= MOST && !self.buckets.contains_key(&key) {
            self.make_room(now);
        }
        let new = || (Flood::new(self.allowance, now), now);
        let (bucket, used) = self.buckets.entry(key).or_insert_with(new);
        *used = now;
        bucket.spend(1.0, now) == Verdict::Pass
    }

    /// A bucket that was left alone is full again: forgetting it changes nothing. Where there are
    /// none of these, the room is for those who come first.
    fn make_room(&mut self, now: Instant) {
        let full = Duration::from_secs_f64(self.allowance.burst / self.allowance.per_second);
        self.buckets
            .retain(|_, (_, used)| now.saturating_duration_since(*used) < full);
        if self.buckets.len() >= MOST {
            let mut used: Vec<Instant> = self.buckets.values().map(|(_, used)| *used).collect();
            used.sort_unstable();
            let oldest = used.get(MOST / 4).copied().unwrap_or(now);
            self.buckets.retain(|_, (_, used)| *used > oldest);
        }
    }
}

/// The limits of the API.
pub(crate) struct Rates {
    addresses: Mutex<Buckets<IpAddr>>,
    users: Mutex<Buckets<UserName>>,
}

impl Rates {
    /// Nobody has asked for anything yet.
    pub(crate) fn new() -> Self {
        Self {
            addresses: Mutex::new(Buckets::new(ADDRESS)),
            users: Mutex::new(Buckets::new(USER)),
        }
    }

    /// Counts a request from `address`, on all servers together.
    pub(super) async fn address(
        &self,
        address: IpAddr,
        together: Option<&Together>,
    ) -> Result<(), Problem> {
        let place = neighbourhood(address);
        spend(&self.addresses, place, "address", ADDRESS)?;
        spend_together(together, &place.to_string(), "address", ADDRESS).await
    }

    /// Counts a request of `user`, on all servers together.
    pub(super) async fn user(
        &self,
        user: &UserName,
        together: Option<&Together>,
    ) -> Result<(), Problem> {
        spend(&self.users, user.clone(), "user", USER)?;
        spend_together(together, user.as_str(), "user", USER).await
    }
}

/// Without Redis every server counts for itself: that more is let through is better than that nothing
/// is.
async fn spend_together(
    together: Option<&Together>,
    name: &str,
    whose: &str,
    allowance: Allowance,
) -> Result<(), Problem> {
    let Some(together) = together.filter(|together| together.is_member()) else {
        return Ok(());
    };
    let bucket = Bucket {
        per_second: allowance.per_second,
        burst: allowance.burst,
    };
    let name = format!("{whose}:{name}");
    match together.cluster.spend(&name, bucket, 1).await {
        Ok(Spent::Refused) => Err(too_many(whose, allowance)),
        Ok(Spent::Passed) | Err(_) => Ok(()),
    }
}

fn too_many(whose: &str, allowance: Allowance) -> Problem {
    Problem::later(
        StatusCode::TOO_MANY_REQUESTS,
        "rate_limited",
        format!(
            "too many requests: one {whose} may make {} a second",
            allowance.per_second
        ),
        Duration::from_secs(1),
    )
}

fn spend<K: Hash + Eq>(
    buckets: &Mutex<Buckets<K>>,
    key: K,
    whose: &str,
    allowance: Allowance,
) -> Result<(), Problem> {
    let mut buckets = buckets.lock().unwrap_or_else(PoisonError::into_inner);
    if buckets.spend(key, Instant::now()) {
        return Ok(());
    }
    Err(too_many(whose, allowance))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_asks_too_often_has_to_wait() {
        let mut buckets = Buckets::new(USER);
        let now = Instant::now();
        let passed = (0..1_000).filter(|_| buckets.spend("ada", now)).count();
        assert_eq!(passed, 300);
        assert!(buckets.spend("bob", now), "others do not");
        assert!(buckets.spend("ada", now + Duration::from_secs(1)));
    }

    #[test]
    fn a_million_addresses_take_no_more_room_than_some_thousands() {
        let mut buckets = Buckets::new(ADDRESS);
        let now = Instant::now();
        for key in 0..100_000_u32 {
            let at = now + Duration::from_micros(key.into());
            assert!(buckets.spend(key, at));
            assert!(buckets.buckets.len() <= MOST);
        }
    }
}
