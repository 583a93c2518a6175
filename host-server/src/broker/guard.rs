//! Who may connect to the embedded broker, and what they may publish.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use crawler_protocol::{Fleet, MAX_MESSAGE, Topic};
use rmqtt::codec::v5::PublishAckReason;
use rmqtt::hook::{Handler, HookResult, Parameter, ReturnType};
use rmqtt::types::{AuthResult, ConnectInfo, Publish, PublishAclResult, PublishResult};

use super::Credentials;

/// What one client may publish per second without being slowed down. A robot publishes about
/// seven messages a second; a controller steering at 50 Hz stays far below as well.
const RATE: f64 = 500.0;
/// What it may publish at once after a pause.
const BURST: f64 = 1_000.0;
/// Bytes that count as one message.
const UNIT: usize = 1_024;
/// Longest wait that one message can cost. The largest packet is worth 256 units.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// What the guard has done so far.
#[derive(Debug, Default)]
pub(crate) struct GuardCounters {
    /// Publishes refused because of their size.
    pub(crate) oversize: AtomicU64,
    /// Publishes refused because they wanted to be retained where nothing is.
    pub(crate) retain_refused: AtomicU64,
    /// Messages not retained because the storage is full.
    pub(crate) not_retained: AtomicU64,
    /// Publishes that had to wait because their client was over its budget.
    pub(crate) delayed: AtomicU64,
    /// Connections refused because of credentials nobody knows.
    pub(crate) refused: AtomicU64,
}

/// The broker's hook.
///
/// There are no accounts yet: whoever reaches the port may connect without a name, and a name is
/// refused because none exists. The server's own session proves itself with a secret made up at
/// start, and is exempt from the rules below.
#[derive(Clone)]
pub(super) struct Guard {
    fleet: Fleet,
    server: Credentials,
    counters: Arc<GuardCounters>,
    budgets: Arc<Mutex<HashMap<String, Budget>>>,
}

impl Guard {
    pub(super) fn new(fleet: Fleet, server: Credentials, counters: Arc<GuardCounters>) -> Self {
        Self {
            fleet,
            server,
            counters,
            budgets: Arc::default(),
        }
    }

    fn authenticate(&self, info: &ConnectInfo) -> AuthResult {
        match (info.username(), info.password()) {
            (None, None) => AuthResult::Allow(false, None),
            (Some(user), Some(password))
                if *user == self.server.user
                    && password.as_ref() == self.server.password.as_bytes() =>
            {
                AuthResult::Allow(true, None)
            }
            _ => {
                self.counters.refused.fetch_add(1, Ordering::Relaxed);
                AuthResult::BadUsernameOrPassword
            }
        }
    }

    /// Nothing but images and firmware may be longer than a message of the contract, whatever
    /// the topic: a robot that announced its largest packet would lose its session over one.
    fn check(&self, publish: &Publish) -> Result<(), &'static str> {
        let topic = Topic::parse(&self.fleet, &publish.topic);
        let bulk = matches!(topic, Ok(Topic::Image(_) | Topic::Ota(_)));
        if !bulk && publish.payload.len() > MAX_MESSAGE {
            self.counters.oversize.fetch_add(1, Ordering::Relaxed);
            return Err("larger than 1024 bytes");
        }
        if publish.retain && !topic.is_ok_and(|topic| topic.retained()) {
            self.counters.retain_refused.fetch_add(1, Ordering::Relaxed);
            return Err("only status and parameters of a robot are retained");
        }
        Ok(())
    }

    /// How long the client has to wait before `bytes` more go through.
    fn spend(&self, client: &str, bytes: usize, now: Instant) -> Duration {
        let mut budgets = self.budgets.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(budget) = budgets.get_mut(client) {
            return budget.spend(bytes, now);
        }
        let mut budget = Budget::new(now);
        let wait = budget.spend(bytes, now);
        budgets.insert(client.to_owned(), budget);
        wait
    }
}

// The trait leaves this lifetime out, and async-trait wants the implementation to do the same.
#[allow(elided_lifetimes_in_paths)]
#[async_trait]
impl Handler for Guard {
    async fn hook(&self, parameter: &Parameter, previous: Option<HookResult>) -> ReturnType {
        match parameter {
            Parameter::ClientAuthenticate(info) => {
                let result = self.authenticate(info);
                (false, Some(HookResult::AuthResult(result)))
            }
            Parameter::MessagePublishCheckAcl(session, publish) => {
                let wait = self.spend(&session.id.client_id, publish.payload.len(), Instant::now());
                if !wait.is_zero() {
                    // The session reads nothing while it waits, so its TCP window fills up and
                    // the flood stays with its sender.
                    self.counters.delayed.fetch_add(1, Ordering::Relaxed);
                    tokio::time::sleep(wait).await;
                }
                let result = match self.check(publish) {
                    Ok(()) => PublishAclResult::allow(),
                    Err(text) => PublishAclResult(PublishResult::reason_code(
                        PublishAckReason::QuotaExceeded,
                        Some(text.into()),
                        false,
                    )),
                };
                (false, Some(HookResult::PublishAclResult(result)))
            }
            Parameter::ClientDisconnected(session, _) => {
                self.budgets
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .remove(session.id.client_id.as_ref() as &str);
                (true, previous)
            }
            _ => (true, previous),
        }
    }
}

/// A token bucket that may go into debt; the debt is what the client waits for.
#[derive(Debug)]
struct Budget {
    tokens: f64,
    at: Instant,
}

impl Budget {
    fn new(now: Instant) -> Self {
        Self {
            tokens: BURST,
            at: now,
        }
    }

    fn spend(&mut self, bytes: usize, now: Instant) -> Duration {
        let earned = now.saturating_duration_since(self.at).as_secs_f64() * RATE;
        self.at = now;
        self.tokens = (self.tokens + earned).min(BURST) - bytes.div_ceil(UNIT).max(1) as f64;
        if self.tokens >= 0.0 {
            return Duration::ZERO;
        }
        Duration::from_secs_f64(-self.tokens / RATE).min(LONGEST_WAIT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_never_waits() {
        let start = Instant::now();
        let mut budget = Budget::new(start);
        for message in 0..10_000_u64 {
            let now = start + Duration::from_millis(message * 1000 / 20);
            assert_eq!(budget.spend(400, now), Duration::ZERO, "message {message}");
        }
    }

    #[test]
    fn a_flood_is_slowed_to_the_rate() {
        let mut now = Instant::now();
        let start = now;
        let mut budget = Budget::new(now);
        for _ in 0..6_000 {
            now += budget.spend(100, now);
        }
        // A burst of 1,000 is free, the other 5,000 come at 500 a second.
        let took = now - start;
        assert!(took >= Duration::from_millis(9_900), "{took:?}");
        assert!(took <= Duration::from_millis(10_100), "{took:?}");
    }

    #[test]
    fn bytes_count_too() {
        let now = Instant::now();
        let mut budget = Budget::new(now);
        let waits: Duration = (0..8).map(|_| budget.spend(256 * 1024, now)).sum();
        assert!(waits > Duration::from_secs(1), "{waits:?}");
    }
}
