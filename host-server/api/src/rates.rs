//! How many requests one address and one user may make.
//!
//! Halts have a budget of their own: whatever else somebody asks for, and whoever else asks from the same
//! address, a stop goes through. Probes have one too, so that a monitor takes nothing from people.

use std::collections::HashMap;
use std::hash::Hash;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::extract::{MatchedPath, Request};
use axum::http::Method;
use crawler_access::UserName;
use crawler_access::limits::{Allowance, Flood, Verdict};
use crawler_cluster::{Bucket, Spent};
use crawler_system::neighbourhood;

use super::problem::{Code, Problem};
use crawler_cluster::ClusterMembership;

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
/// Halts of one user. Somebody who hammers on the key makes ten a second; a page that stops a selection
/// of robots one by one makes thirty.
const USER_HALTS: Allowance = Allowance {
    per_second: 50.0,
    burst: 200.0,
    debt: 0.0,
    patience: Duration::ZERO,
};
/// Halts of one address on an open server, where nobody has a name.
const ADDRESS_HALTS: Allowance = Allowance {
    per_second: 100.0,
    burst: 400.0,
    debt: 0.0,
    patience: Duration::ZERO,
};
/// Probes of one address. Several monitors that ask every second are far below.
const ADDRESS_PROBES: Allowance = Allowance {
    per_second: 50.0,
    burst: 200.0,
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

/// What a request is charged to, as far as its head tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Charge {
    /// A monitor's question.
    Probe,
    /// A command, which may be a halt: the body says.
    Command,
    /// Anything else.
    Other,
}

impl Charge {
    /// What `request` is charged to.
    pub(super) fn of(request: &Request) -> Self {
        let path = request.extensions().get::<MatchedPath>();
        let get = matches!(*request.method(), Method::GET | Method::HEAD);
        match path.map(MatchedPath::as_str) {
            Some("/healthz" | "/readyz" | "/metrics") if get => Self::Probe,
            Some("/api/v1/robots/{id}/commands" | "/api/v1/swarm/commands")
                if request.method() == Method::POST =>
            {
                Self::Command
            }
            _ => Self::Other,
        }
    }
}

/// The limits of the API.
pub(super) struct Rates {
    addresses: Mutex<Buckets<IpAddr>>,
    users: Mutex<Buckets<UserName>>,
    address_halts: Mutex<Buckets<IpAddr>>,
    user_halts: Mutex<Buckets<UserName>>,
    probes: Mutex<Buckets<IpAddr>>,
}

impl Rates {
    /// Nobody has asked for anything yet.
    pub(super) fn new() -> Self {
        Self {
            addresses: Mutex::new(Buckets::new(ADDRESS)),
            users: Mutex::new(Buckets::new(USER)),
            address_halts: Mutex::new(Buckets::new(ADDRESS_HALTS)),
            user_halts: Mutex::new(Buckets::new(USER_HALTS)),
            probes: Mutex::new(Buckets::new(ADDRESS_PROBES)),
        }
    }

    /// Counts a request from `address`, on all servers together.
    pub(super) async fn address(
        &self,
        address: IpAddr,
        membership: Option<&ClusterMembership>,
    ) -> Result<(), Problem> {
        let place = neighbourhood(address);
        spend(&self.addresses, place, "address", ADDRESS)?;
        spend_shared(membership, &place.to_string(), "address", ADDRESS).await
    }

    /// Counts a request of `user`, on all servers together.
    pub(super) async fn user(
        &self,
        user: &UserName,
        membership: Option<&ClusterMembership>,
    ) -> Result<(), Problem> {
        spend(&self.users, user.clone(), "user", USER)?;
        spend_shared(membership, user.as_str(), "user", USER).await
    }

    /// Counts a halt of `user`, or of `address` where nobody has a name. On this server alone: a halt
    /// waits for nothing.
    pub(super) fn halt(&self, user: Option<&UserName>, address: IpAddr) -> Result<(), Problem> {
        match user {
            Some(user) => spend(&self.user_halts, user.clone(), "user", USER_HALTS),
            None => spend(
                &self.address_halts,
                neighbourhood(address),
                "address",
                ADDRESS_HALTS,
            ),
        }
    }

    /// Counts a probe from `address`, on this server alone: it is the one that is asked about.
    pub(super) fn probe(&self, address: IpAddr) -> Result<(), Problem> {
        let place = neighbourhood(address);
        spend(&self.probes, place, "address", ADDRESS_PROBES)
    }
}

/// Without Redis every server counts for itself: that more is let through is better than that nothing
/// is.
async fn spend_shared(
    membership: Option<&ClusterMembership>,
    name: &str,
    whose: &str,
    allowance: Allowance,
) -> Result<(), Problem> {
    let Some(membership) = membership.filter(|membership| membership.is_member()) else {
        return Ok(());
    };
    let bucket = Bucket {
        per_second: allowance.per_second,
        burst: allowance.burst,
    };
    let name = format!("{whose}:{name}");
    match membership.cluster.spend(&name, bucket, 1).await {
        Ok(Spent::Refused) => Err(too_many(whose, allowance)),
        Ok(Spent::Passed) | Err(_) => Ok(()),
    }
}

fn too_many(whose: &str, allowance: Allowance) -> Problem {
    Problem::later(
        Code::RateLimited,
        format!(
            "too many requests: one {whose} may make {} of this kind a second",
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
