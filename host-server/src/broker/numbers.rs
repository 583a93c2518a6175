//! How full the embedded broker is.

use rmqtt::context::ServerContext;

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

impl Load {
    /// Asks the library. Messages are counted where they are: its own counts of them keep those of sessions
    /// that have ended for ever.
    pub(super) async fn of(broker: &ServerContext) -> Self {
        // The library counts in signed numbers and may be one below for a moment.
        let count = |value: isize| u64::try_from(value).unwrap_or(0);
        let mut load = Self {
            connections: count(broker.connections.count()),
            sessions: count(broker.sessions.count()),
            subscriptions: count(broker.stats.subscriptions.count()),
            queued: 0,
            unacknowledged: 0,
        };
        let sessions: Vec<_> = {
            let shared = broker.extends.shared().await;
            shared.iter().filter_map(|entry| entry.session()).collect()
        };
        for session in sessions {
            load.queued += session.deliver_queue().len() as u64;
            load.unacknowledged += session.out_inflight().read().await.len() as u64;
        }
        load
    }
}
