//! Who is there: leases, slots, the leader, and what the dead leave behind.

use std::sync::LazyLock;
use std::time::{Duration, Instant};

use redis::Script;

use crate::{Cluster, ClusterError};

/// How long a server counts as there after its last word.
pub const LEASE: Duration = Duration::from_secs(3);
/// How often a server gives its word.
pub const RENEW: Duration = Duration::from_secs(1);
/// Servers that one fleet can have.
pub const SLOTS: u8 = 16;
/// For how long it is known that somebody's commands were taken: longer than any command lives.
const ADOPTED: Duration = Duration::from_hours(24);

/// What came of [`Cluster::join`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Joined {
    /// This server has the slot, for [`LEASE`] from before the call.
    Slot(u8),
    /// What was kept under its name is another server's by now. It has to drop it, and to come back
    /// under another name.
    Adopted,
    /// Another process has the name: it was killed a moment ago, or runs on a copy of the same
    /// folder.
    Taken,
    /// There is no slot left.
    Full,
}

/// What came of [`Cluster::renew`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Renewed {
    /// Until when nobody takes what is this server's.
    pub until: Instant,
    /// Whether it does what only one server is to do.
    pub leader: bool,
    /// What the clock of Redis is ahead of this machine's, in microseconds.
    pub ahead_us: i64,
    /// The greatest number of a command that anybody has told.
    pub greatest: u64,
}

/// The names of what was another server's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adopted {
    /// Whose it was.
    pub from: String,
    /// The commands.
    pub ids: Vec<u64>,
}

/// KEYS alive, adopted, servers, slots…; ARGV token, instance, lease in ms.
static JOIN: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('EXISTS', KEYS[2]) == 1 then return -1 end
local holder = redis.call('GET', KEYS[1])
if holder and holder ~= ARGV[1] then return -2 end
local free = nil
for i = 4, #KEYS do
  local owner = redis.call('GET', KEYS[i])
  if owner == ARGV[2] then free = i break end
  if not owner and not free then free = i end
end
if not free then return -3 end
redis.call('SET', KEYS[free], ARGV[2], 'PX', ARGV[3])
redis.call('SET', KEYS[1], ARGV[1], 'PX', ARGV[3])
redis.call('SADD', KEYS[3], ARGV[2])
return free - 4",
    )
});

/// KEYS alive, slot, leader, greatest; ARGV token, instance, lease in ms.
static RENEW_LEASE: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('GET', KEYS[1]) ~= ARGV[1] or redis.call('GET', KEYS[2]) ~= ARGV[2] then return {} end
redis.call('PEXPIRE', KEYS[1], ARGV[3])
redis.call('PEXPIRE', KEYS[2], ARGV[3])
local leader = redis.call('GET', KEYS[3])
if not leader or leader == ARGV[2] then
  redis.call('SET', KEYS[3], ARGV[2], 'PX', ARGV[3])
  leader = ARGV[2]
end
local time = redis.call('TIME')
local leads = 0
if leader == ARGV[2] then leads = 1 end
return {tostring(leads), time[1], time[2], redis.call('GET', KEYS[4]) or '0'}",
    )
});

/// KEYS alive, slot, leader, owed, servers; ARGV token, instance.
static LEAVE: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('GET', KEYS[1]) ~= ARGV[1] then return 0 end
redis.call('DEL', KEYS[1])
if redis.call('GET', KEYS[2]) == ARGV[2] then redis.call('DEL', KEYS[2]) end
if redis.call('GET', KEYS[3]) == ARGV[2] then redis.call('DEL', KEYS[3]) end
if redis.call('EXISTS', KEYS[4]) == 0 then redis.call('SREM', KEYS[5], ARGV[2]) end
return 1",
    )
});

/// KEYS alive, owed, servers, alive of the other, owed of the other, adopted of the other;
/// ARGV token, instance, the other, seconds that it is remembered.
static ADOPT: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('GET', KEYS[1]) ~= ARGV[1] then return false end
if redis.call('EXISTS', KEYS[4]) == 1 then return false end
if redis.call('SREM', KEYS[3], ARGV[3]) == 0 then return false end
local ids = redis.call('SMEMBERS', KEYS[5])
redis.call('SUNIONSTORE', KEYS[2], KEYS[2], KEYS[5])
redis.call('DEL', KEYS[5])
redis.call('SET', KEYS[6], ARGV[2], 'EX', ARGV[4])
return ids",
    )
});

impl Cluster {
    pub(crate) fn alive(&self, instance: &str) -> String {
        self.key(&format!("alive:{instance}"))
    }

    pub(crate) fn owed(&self, instance: &str) -> String {
        self.key(&format!("owed:{instance}"))
    }

    fn adopted(&self, instance: &str) -> String {
        self.key(&format!("adopted:{instance}"))
    }

    fn slot(&self, slot: u8) -> String {
        self.key(&format!("slot:{slot}"))
    }

    /// Takes a slot, or the one that this server still has.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn join(&self) -> Result<Joined, ClusterError> {
        let instance = self.instance();
        let mut call = JOIN.key(self.alive(&instance));
        call.key(self.adopted(&instance)).key(self.key("servers"));
        for slot in 0..SLOTS {
            call.key(self.slot(slot));
        }
        call.arg(self.token()).arg(&instance).arg(milliseconds());
        let result = call.invoke_async(&mut self.connection.clone()).await;
        let slot: i64 = self.noted(result)?;
        Ok(match slot {
            -1 => Joined::Adopted,
            -2 => Joined::Taken,
            slot => match u8::try_from(slot) {
                Ok(slot) if slot < SLOTS => Joined::Slot(slot),
                _ => Joined::Full,
            },
        })
    }

    /// Keeps `slot`, and everything else that goes with being there.
    ///
    /// # Errors
    /// [`ClusterError::NoLease`] when it is too late: [`Cluster::join`] again.
    /// [`ClusterError::Away`].
    pub async fn renew(&self, slot: u8) -> Result<Renewed, ClusterError> {
        let instance = self.instance();
        let asked = Instant::now();
        let asked_us = unix_us();
        let result = RENEW_LEASE
            .key(self.alive(&instance))
            .key(self.slot(slot))
            .key(self.key("leader"))
            .key(self.key("greatest"))
            .arg(self.token())
            .arg(&instance)
            .arg(milliseconds())
            .invoke_async(&mut self.connection.clone())
            .await;
        let answer: Vec<String> = self.noted(result)?;
        let numbers: Option<Vec<u64>> = answer.iter().map(|text| text.parse().ok()).collect();
        let Some(&[leader, seconds, micros, greatest]) = numbers.as_deref() else {
            return Err(ClusterError::NoLease);
        };
        // Redis looked at its clock about half way between.
        let half = u64::try_from(asked.elapsed().as_micros() / 2).unwrap_or(0);
        let theirs = seconds.saturating_mul(1_000_000).saturating_add(micros);
        Ok(Renewed {
            until: asked + LEASE,
            leader: leader == 1,
            ahead_us: (theirs as i64).saturating_sub((asked_us + half) as i64),
            greatest,
        })
    }

    /// Says goodbye: the others may take over at once.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn leave(&self, slot: u8) -> Result<(), ClusterError> {
        let instance = self.instance();
        let result = LEAVE
            .key(self.alive(&instance))
            .key(self.slot(slot))
            .key(self.key("leader"))
            .key(self.owed(&instance))
            .key(self.key("servers"))
            .arg(self.token())
            .arg(&instance)
            .invoke_async(&mut self.connection.clone())
            .await;
        self.noted(result)
    }

    /// Takes over from servers that are gone. What is returned is this server's from here on.
    ///
    /// # Errors
    /// [`ClusterError::Away`]. Then something may have been taken over unseen: the next
    /// [`Cluster::mine`] tells.
    pub async fn adopt(&self) -> Result<Vec<Adopted>, ClusterError> {
        let instance = self.instance();
        let mut command = redis::cmd("SMEMBERS");
        command.arg(self.key("servers"));
        let servers: Result<Vec<String>, _> =
            command.query_async(&mut self.connection.clone()).await;
        let mut all = Vec::new();
        for other in self.noted(servers)? {
            if other == instance {
                continue;
            }
            let result = ADOPT
                .key(self.alive(&instance))
                .key(self.owed(&instance))
                .key(self.key("servers"))
                .key(self.alive(&other))
                .key(self.owed(&other))
                .key(self.adopted(&other))
                .arg(self.token())
                .arg(&instance)
                .arg(&other)
                .arg(ADOPTED.as_secs())
                .invoke_async(&mut self.connection.clone())
                .await;
            let ids: Option<Vec<u64>> = self.noted(result)?;
            if let Some(ids) = ids {
                all.push(Adopted { from: other, ids });
            }
        }
        Ok(all)
    }

    /// Everything that is kept under this server's name.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn mine(&self) -> Result<Vec<u64>, ClusterError> {
        let mut command = redis::cmd("SMEMBERS");
        command.arg(self.owed(&self.instance()));
        let ids = command.query_async(&mut self.connection.clone()).await;
        self.noted(ids)
    }
}

fn milliseconds() -> u64 {
    u64::try_from(LEASE.as_millis()).unwrap_or(u64::MAX)
}

fn unix_us() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |elapsed| elapsed.as_micros() as u64)
}
