//! How full the embedded broker is.

use rmqtt::context::ServerContext;

use super::GuardCounters;

/// What the broker holds at this moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Load {
    /// Open connections.
    pub(crate) connections: u64,
    /// Sessions, also those whose client is away and may return.
    pub(crate) sessions: u64,
    /// Subscriptions of all sessions.
    pub(crate) subscriptions: u64,
    /// Messages waiting for their session to take them.
    pub(crate) queued: u64,
    /// QoS 1 messages sent and not acknowledged.
    pub(crate) unacknowledged: u64,
}

impl GuardCounters {
    /// Takes note of the broker these counters belong to.
    pub(super) fn watch(&self, broker: ServerContext) {
        // Set once, when the broker starts.
        let _ = self.broker.set(broker);
    }

    /// What the broker holds; nothing before it runs.
    pub(crate) fn load(&self) -> Load {
        let Some(broker) = self.broker.get() else {
            return Load::default();
        };
        // The library counts in signed numbers and may be one below for a moment.
        let count = |value: isize| u64::try_from(value).unwrap_or(0);
        Load {
            connections: count(broker.connections.count()),
            sessions: count(broker.sessions.count()),
            subscriptions: count(broker.stats.subscriptions.count()),
            queued: count(broker.stats.message_queues.count()),
            unacknowledged: count(broker.stats.out_inflights.count()),
        }
    }
}
