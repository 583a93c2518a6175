//! Commands that robots are owed, and what became of them.
//!
//! Each is a hash with one field per robot and one for the command itself. Its id is in the set of
//! the server that delivers it, until nothing is left to do.

use std::collections::BTreeMap;
use std::sync::LazyLock;
use std::time::Duration;

use redis::Script;

use crate::{Cluster, ClusterError};

/// The field that is the command's own; no robot has an empty name.
pub const HEAD: &str = "";
/// A command can be asked for this long, and lives for less.
const KEPT: Duration = Duration::from_mins(75);

/// The fields of a command.
pub type Fields = BTreeMap<String, String>;

/// KEYS alive, owed, greatest, command; ARGV token, id, seconds, fields…
static ACCEPT: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('GET', KEYS[1]) ~= ARGV[1] then return false end
for i = 4, #ARGV, 1000 do
  redis.call('HSET', KEYS[4], unpack(ARGV, i, math.min(i + 999, #ARGV)))
end
redis.call('EXPIRE', KEYS[4], ARGV[3])
redis.call('SADD', KEYS[2], ARGV[2])
local greatest = redis.call('GET', KEYS[3])
if not greatest or tonumber(greatest) < tonumber(ARGV[2]) then
  greatest = ARGV[2]
  redis.call('SET', KEYS[3], greatest)
end
return greatest",
    )
});

/// KEYS alive, owed, command; ARGV token, id, whether nothing is left to do, fields…
static UPDATE: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('GET', KEYS[1]) ~= ARGV[1] then return 0 end
if redis.call('SISMEMBER', KEYS[2], ARGV[2]) == 1 and redis.call('EXISTS', KEYS[3]) == 1 then
  for i = 4, #ARGV, 1000 do
    redis.call('HSET', KEYS[3], unpack(ARGV, i, math.min(i + 999, #ARGV)))
  end
end
if ARGV[3] == '1' then redis.call('SREM', KEYS[2], ARGV[2]) end
return 1",
    )
});

/// KEYS alive, owed, command; ARGV token, id.
static RETRACT: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('GET', KEYS[1]) ~= ARGV[1] then return 0 end
if redis.call('SREM', KEYS[2], ARGV[2]) == 1 then redis.call('DEL', KEYS[3]) end
return 1",
    )
});

impl Cluster {
    fn command(&self, id: u64) -> String {
        self.key(&format!("command:{id}"))
    }

    /// Keeps a command as this server's; nobody may be told that it is accepted before this
    /// returns. Returns the greatest number of a command so far.
    ///
    /// # Errors
    /// [`ClusterError::NoLease`]; [`ClusterError::Away`]: see [`Cluster::retract`].
    pub async fn accept(&self, id: u64, fields: &Fields) -> Result<u64, ClusterError> {
        let instance = self.instance();
        let mut call = ACCEPT.key(self.alive(&instance));
        call.key(self.owed(&instance))
            .key(self.key("greatest"))
            .key(self.command(id))
            .arg(self.token())
            .arg(id)
            .arg(KEPT.as_secs());
        for (name, value) in fields {
            call.arg(name).arg(value);
        }
        let result = call.invoke_async(&mut self.connection.clone()).await;
        let greatest: Option<u64> = self.noted(result)?;
        greatest.ok_or(ClusterError::NoLease)
    }

    /// Writes what has become of a command of this server; of another's nothing is written. When nothing is left to do, it is nobody's any more.
    ///
    /// # Errors
    /// [`ClusterError::NoLease`] and [`ClusterError::Away`].
    pub async fn update(
        &self,
        id: u64,
        fields: &Fields,
        finished: bool,
    ) -> Result<(), ClusterError> {
        let instance = self.instance();
        let mut call = UPDATE.key(self.alive(&instance));
        call.key(self.owed(&instance))
            .key(self.command(id))
            .arg(self.token())
            .arg(id)
            .arg(u8::from(finished));
        for (name, value) in fields {
            call.arg(name).arg(value);
        }
        let result = call.invoke_async(&mut self.connection.clone()).await;
        leased(self.noted(result)?)
    }

    /// Takes back a command that nobody was told is accepted.
    ///
    /// # Errors
    /// [`ClusterError::NoLease`] and [`ClusterError::Away`].
    pub async fn retract(&self, id: u64) -> Result<(), ClusterError> {
        let instance = self.instance();
        let result = RETRACT
            .key(self.alive(&instance))
            .key(self.owed(&instance))
            .key(self.command(id))
            .arg(self.token())
            .arg(id)
            .invoke_async(&mut self.connection.clone())
            .await;
        leased(self.noted(result)?)
    }

    /// What is known of a command, whosever it is. Empty when there is none.
    ///
    /// # Errors
    /// [`ClusterError::Away`].
    pub async fn read(&self, id: u64) -> Result<Fields, ClusterError> {
        let mut command = redis::cmd("HGETALL");
        command.arg(self.command(id));
        let fields = command.query_async(&mut self.connection.clone()).await;
        self.noted(fields)
    }
}

fn leased(done: u8) -> Result<(), ClusterError> {
    if done == 1 {
        Ok(())
    } else {
        Err(ClusterError::NoLease)
    }
}
