//! How often one may fail, and how much one may send. Time is handed in.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::{Duration, Instant};

/// How failed logins are slowed down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backoff {
    /// Failures that cost nothing.
    pub free: u32,
    /// Wait after the last of them. Each further failure doubles it.
    pub first: Duration,
    /// Longest wait.
    pub longest: Duration,
    /// Time without failure after which everything is forgotten.
    pub forget: Duration,
    /// Most keys that are remembered.
    pub most: usize,
}

impl Default for Backoff {
    /// Five attempts, then a wait of 2 s that doubles up to 15 min. At that pace somebody guesses a
    /// hundred passwords in a day.
    fn default() -> Self {
        Self {
            free: 5,
            first: Duration::from_secs(2),
            longest: Duration::from_mins(15),
            forget: Duration::from_hours(1),
            most: 8_192,
        }
    }
}

/// Failed logins per key, such as a name together with an address.
///
/// The memory is bounded: when it is full, what is past goes first, then those with the fewest
/// failures. Whoever wants to be forgotten has to fail thousands of times more.
#[derive(Debug)]
pub struct Attempts<K> {
    backoff: Backoff,
    failures: HashMap<K, Failures>,
}

#[derive(Debug, Clone, Copy)]
struct Failures {
    count: u32,
    last: Instant,
}

impl<K: Hash + Eq + Clone> Attempts<K> {
    /// Nobody has failed yet.
    #[must_use]
    pub fn new(backoff: Backoff) -> Self {
        Self {
            backoff,
            failures: HashMap::new(),
        }
    }

    /// Whether `key` may try now.
    ///
    /// # Errors
    /// How long it has to wait until it may.
    pub fn check(&self, key: &K, now: Instant) -> Result<(), Duration> {
        let Some(failures) = self.failures.get(key) else {
            return Ok(());
        };
        let wait = self
            .backoff
            .wait(failures.count)
            .saturating_sub(now.saturating_duration_since(failures.last));
        if wait.is_zero() { Ok(()) } else { Err(wait) }
    }

    /// [`check`](Self::check), and counts the attempt as failed until [`succeeded`](Self::succeeded)
    /// says otherwise: many attempts at the same time then count as many.
    ///
    /// # Errors
    /// How long `key` has to wait until it may try. Such an attempt is not counted.
    pub fn begin(&mut self, key: &K, now: Instant) -> Result<(), Duration> {
        self.check(key, now)?;
        self.failed(key, now);
        Ok(())
    }

    /// `key` has failed.
    pub fn failed(&mut self, key: &K, now: Instant) {
        let forget = self.backoff.forget;
        if let Some(failures) = self.failures.get_mut(key) {
            if now.saturating_duration_since(failures.last) >= forget {
                failures.count = 0;
            }
            failures.count = failures.count.saturating_add(1);
            failures.last = now;
            return;
        }
        self.make_room(now);
        let failures = Failures {
            count: 1,
            last: now,
        };
        self.failures.insert(key.clone(), failures);
    }

    /// `key` has proven itself: its failures are forgotten.
    pub fn succeeded(&mut self, key: &K) {
        self.failures.remove(key);
    }

    /// Keys that are remembered.
    #[must_use]
    pub fn len(&self) -> usize {
        self.failures.len()
    }

    /// Whether nobody has failed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.failures.is_empty()
    }

    /// Room for one key. A quarter goes at once, so that this is seldom.
    fn make_room(&mut self, now: Instant) {
        let most = self.backoff.most.max(1);
        if self.failures.len() < most {
            return;
        }
        let forget = self.backoff.forget;
        self.failures
            .retain(|_, failures| now.saturating_duration_since(failures.last) < forget);
        if self.failures.len() < most {
            return;
        }
        let mut order: Vec<_> = self
            .failures
            .iter()
            .map(|(key, failures)| (failures.count, failures.last, key.clone()))
            .collect();
        order.sort_by_key(|(count, last, _)| (*count, *last));
        for (_, _, key) in order.iter().take((most / 4).max(1)) {
            self.failures.remove(key);
        }
    }
}

impl Backoff {
    /// The wait after so many failures.
    fn wait(&self, failures: u32) -> Duration {
        let Some(beyond) = failures.checked_sub(self.free.max(1)) else {
            return Duration::ZERO;
        };
        let factor = 1_u32.checked_shl(beyond).unwrap_or(u32::MAX);
        self.first.saturating_mul(factor).min(self.longest)
    }
}

/// How much one client may send.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    /// Units per second, for ever.
    pub per_second: f64,
    /// Units at once after a pause.
    pub burst: f64,
    /// Units that may be owed. What would go beyond is cut off.
    pub debt: f64,
    /// How long one may be over the allowance without a pause. Then one is cut off.
    pub patience: Duration,
}

/// What is to be done with what a client sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It goes through.
    Pass,
    /// It goes through after this time, or the client is told to come back then.
    Wait(Duration),
    /// The client floods on purpose, or is broken: end its session.
    CutOff,
}

/// A token bucket that may go into debt.
#[derive(Debug, Clone)]
pub struct Flood {
    allowance: Allowance,
    tokens: f64,
    at: Instant,
    /// Since when the client has been over its allowance.
    over: Option<Instant>,
}

impl Flood {
    /// A full bucket.
    #[must_use]
    pub fn new(allowance: Allowance, now: Instant) -> Self {
        Self {
            allowance,
            tokens: allowance.burst,
            at: now,
            over: None,
        }
    }

    /// Takes `units` out.
    pub fn spend(&mut self, units: f64, now: Instant) -> Verdict {
        let Allowance {
            per_second,
            burst,
            debt,
            patience,
        } = self.allowance;
        let passed = now.saturating_duration_since(self.at);
        self.at = self.at.max(now);
        self.tokens = (self.tokens + passed.as_secs_f64() * per_second).min(burst);
        // Half a bucket takes a pause: whoever waits exactly as told never has it.
        if self.tokens >= burst / 2.0 {
            self.over = None;
        }
        self.tokens -= units;
        if self.tokens >= 0.0 {
            return Verdict::Pass;
        }
        let since = *self.over.get_or_insert(now);
        if -self.tokens > debt || now.saturating_duration_since(since) > patience {
            // Bounded, so that a pause of known length makes good again.
            self.tokens = self.tokens.max(-debt);
            return Verdict::CutOff;
        }
        let wait = -self.tokens / per_second;
        Verdict::Wait(Duration::try_from_secs_f64(wait).unwrap_or(Duration::MAX))
    }
}

#[cfg(test)]
#[path = "limits_tests.rs"]
mod tests;
