//! Limits that hold for all servers together, and secrets that any of them can redeem once.

use std::sync::LazyLock;
use std::time::Duration;

use redis::Script;

use crate::{Cluster, ClusterError};

/// A bucket that fills with time and that every request takes one out of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bucket {
    /// How fast it fills.
    pub per_second: f64,
    /// How much goes in.
    pub burst: f64,
}

/// What came of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spent {
    /// There was enough.
    Passed,
    /// The bucket is empty.
    Refused,
}

/// KEYS bucket; ARGV per second, burst, how many. By the clock of Redis: servers may disagree.
static SPEND: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
local time = redis.call('TIME')
local now = tonumber(time[1]) + tonumber(time[2]) / 1e6
local rate, burst, want = tonumber(ARGV[1]), tonumber(ARGV[2]), tonumber(ARGV[3])
local known = redis.call('HMGET', KEYS[1], 'level', 'at')
local level = burst
if known[1] then
  level = math.min(burst, tonumber(known[1]) + math.max(0, now - tonumber(known[2])) * rate)
end
local passed = 0
if level >= want then level = level - want passed = 1 end
redis.call('HSET', KEYS[1], 'level', string.format('%.6f', level), 'at', string.format('%.6f', now))
redis.call('PEXPIRE', KEYS[1], math.ceil(burst / rate * 1000) + 1000)
return passed",
    )
});

impl Cluster {
    /// Takes `count` out of the bucket `name`, which is full at first.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn spend(
        &self,
        name: &str,
        bucket: Bucket,
        count: u32,
    ) -> Result<Spent, ClusterError> {
        let result = SPEND
            .key(self.key(&format!("bucket:{name}")))
            .arg(bucket.per_second)
            .arg(bucket.burst)
            .arg(count)
            .invoke_async(&mut self.connection.clone())
            .await;
        let passed: u8 = self.noted(result)?;
        Ok(if passed == 1 {
            Spent::Passed
        } else {
            Spent::Refused
        })
    }

    /// Keeps `value` for whoever shows `name` first.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn lend(
        &self,
        name: &str,
        value: &str,
        lifetime: Duration,
    ) -> Result<(), ClusterError> {
        let mut command = redis::cmd("SET");
        command
            .arg(self.key(&format!("ticket:{name}")))
            .arg(value)
            .arg("PX")
            .arg(u64::try_from(lifetime.as_millis()).unwrap_or(u64::MAX));
        let result = command.query_async(&mut self.connection.clone()).await;
        self.noted(result)
    }

    /// What was kept under `name`, once.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn redeem(&self, name: &str) -> Result<Option<String>, ClusterError> {
        let mut command = redis::cmd("GETDEL");
        command.arg(self.key(&format!("ticket:{name}")));
        let result = command.query_async(&mut self.connection.clone()).await;
        self.noted(result)
    }
}
