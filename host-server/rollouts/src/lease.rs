//! When a rollout of another server is to be taken over. Pure: time is handed in.

use std::collections::BTreeMap;
use std::time::Duration;

use crawler_records::Lease;

/// How often a server says that it lives, and looks whether others do, in milliseconds.
pub(crate) const BEAT_MS: u64 = 1_000;
/// After how long without a word a server counts as gone, by the clock of whoever waits for it: some beats.
pub const LEASE: Duration = Duration::from_secs(5);

/// What was seen of leases of others.
#[derive(Debug)]
pub(crate) struct Watched {
    lease_ms: u64,
    seen: BTreeMap<i64, (Lease, u64)>,
    looked: bool,
}

impl Watched {
    /// Who is silent for as long as `lease` is gone.
    pub(crate) fn new(lease: Duration) -> Self {
        Self {
            lease_ms: u64::try_from(lease.as_millis()).unwrap_or(u64::MAX),
            seen: BTreeMap::new(),
            looked: false,
        }
    }

    /// Forgets how long nobody was heard of: while the records are away, no server is.
    pub(crate) fn forget(&mut self) {
        self.seen.clear();
    }

    /// Takes in the leases of all rollouts but those that `has` says are carried out here, and returns what the
    /// server `own` is to take over. Of a rollout that is its own by name, and that it has just found after its
    /// start, nobody else is to be waited for.
    pub(crate) fn look(
        &mut self,
        leases: Vec<Lease>,
        has: impl Fn(i64) -> bool,
        own: &str,
        now_ms: u64,
    ) -> Vec<Lease> {
        let first = !std::mem::replace(&mut self.looked, true);
        let mut seen = BTreeMap::new();
        let mut gone = Vec::new();
        for lease in leases.into_iter().filter(|lease| !has(lease.id)) {
            let before = self.seen.remove(&lease.id);
            let since = match before {
                Some((before, since)) if before == lease => since,
                _ => now_ms,
            };
            if first && lease.owner == own || now_ms.saturating_sub(since) >= self.lease_ms {
                gone.push(lease.clone());
            }
            seen.insert(lease.id, (lease, since));
        }
        self.seen = seen;
        gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEASE_MS: u64 = 4_000;

    fn watched() -> Watched {
        Watched::new(Duration::from_millis(LEASE_MS))
    }

    fn lease(id: i64, owner: &str, beat: u64) -> Lease {
        Lease {
            id,
            owner: owner.to_owned(),
            epoch: 1,
            beat,
        }
    }

    #[test]
    fn a_server_that_is_silent_loses_its_rollouts() {
        let mut watched = watched();
        let mut look = |leases: &[Lease], now_ms| {
            let gone = watched.look(leases.to_vec(), |id| id == 9, "me", now_ms);
            gone.into_iter().map(|lease| lease.id).collect::<Vec<_>>()
        };
        let (mine, other, here) = (lease(1, "me", 4), lease(2, "you", 4), lease(9, "you", 1));
        // Its own at once, and only when it has just started.
        assert_eq!(look(&[mine.clone(), other.clone(), here.clone()], 0), [1]);
        let mine = lease(1, "me", 5);
        assert!(look(&[mine.clone(), other.clone()], 1_000).is_empty());
        assert!(look(&[mine.clone(), other.clone()], LEASE_MS - 1).is_empty());
        // One that beats stays whose it is.
        let other = lease(2, "you", 5);
        assert!(look(&[mine.clone(), other.clone()], LEASE_MS).is_empty());
        assert_eq!(look(&[mine, other.clone()], 1_000 + LEASE_MS), [1]);
        assert_eq!(look(&[other], 2 * LEASE_MS), [2]);
    }

    #[test]
    fn an_outage_of_the_records_is_nobodys_silence() {
        let mut watched = watched();
        let look = |watched: &mut Watched, now_ms| {
            let gone = watched.look(vec![lease(1, "you", 4)], |_| false, "me", now_ms);
            gone.len()
        };
        assert_eq!(look(&mut watched, 0), 0);
        watched.forget();
        assert_eq!(look(&mut watched, LEASE_MS), 0, "it could not say anything");
        assert_eq!(look(&mut watched, 2 * LEASE_MS - 1), 0);
        assert_eq!(look(&mut watched, 2 * LEASE_MS), 1);
    }
}
