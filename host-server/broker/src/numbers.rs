//! How full the embedded broker is.

use std::sync::atomic::Ordering;

use rmqtt::context::ServerContext;

use super::BrokerHandle;
use crawler_metrics::Exposition;

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
    pub(crate) async fn of(broker: &ServerContext) -> Self {
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

impl BrokerHandle {
    /// How full the broker is, and what it has refused so far.
    pub async fn write_metrics(&self, out: &mut Exposition) {
        let load = self.load().await;
        for (name, help, value) in [
            ("connections", "Open connections", load.connections),
            (
                "sessions",
                "Sessions, also of clients that are away and may return",
                load.sessions,
            ),
            (
                "subscriptions",
                "Subscriptions of all sessions",
                load.subscriptions,
            ),
            (
                "queued",
                "Messages waiting for their session to take them",
                load.queued,
            ),
            (
                "unacknowledged",
                "QoS 1 messages that were sent and not acknowledged",
                load.unacknowledged,
            ),
        ] {
            out.gauge(
                &format!("terracrawler_embedded_broker_{name}"),
                help,
                value as f64,
            );
        }
        let counters = &self.counters;
        for (name, help, value) in [
            (
                "oversize",
                "Publishes refused for their size",
                &counters.oversize,
            ),
            (
                "retain_refused",
                "Publishes refused because nothing is retained on their topic",
                &counters.retain_refused,
            ),
            (
                "not_retained",
                "Messages not retained because the storage is full",
                &counters.not_retained,
            ),
            (
                "delayed",
                "Publishes that waited because their client was over its budget",
                &counters.delayed,
            ),
            ("refused", "Connections refused", &counters.refused),
            (
                "cut_off",
                "Sessions ended because their client stayed over its budget",
                &counters.cut_off,
            ),
            (
                "dropped",
                "Sessions ended because their account or credential was changed",
                &counters.dropped,
            ),
        ] {
            out.counter(
                &format!("terracrawler_embedded_broker_{name}"),
                help,
                value.load(Ordering::Relaxed) as f64,
            );
        }
        out.counters(
            "terracrawler_embedded_broker_refusals",
            "Connections, publishes and subscriptions refused, by reason",
            "reason",
            counters.refusals(),
        );
    }
}
