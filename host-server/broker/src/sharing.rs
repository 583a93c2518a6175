//! Who of a shared subscription gets a message, and how long each client's queue may grow.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use async_trait::async_trait;
use rmqtt::context::ServerContext;
use rmqtt::fitter::{DefaultFitter, FitterManager};
use rmqtt::subscribe::SharedSubscription;
use rmqtt::types::{
    ClientId, ConnectInfo, FitterType, Id, IsOnline, ListenerConfig, NodeId, SharedGroup,
    SubscriptionIdentifier, SubscriptionOptions, TopicName,
};

/// Shared subscriptions in turn, those who are connected before those who are not.
#[derive(Default)]
pub(crate) struct RoundRobin {
    turn: AtomicUsize,
}

type Candidate = (
    NodeId,
    ClientId,
    SubscriptionOptions,
    Option<Vec<SubscriptionIdentifier>>,
    Option<IsOnline>,
);

#[async_trait]
impl SharedSubscription for RoundRobin {
    fn is_supported(&self) -> bool {
        true
    }

    async fn choice(
        &self,
        context: &ServerContext,
        _group: &SharedGroup,
        _publisher: &Id,
        _topic: &TopicName,
        candidates: &[Candidate],
    ) -> Option<(usize, IsOnline)> {
        if candidates.is_empty() {
            return None;
        }
        let start = self.turn.fetch_add(1, Ordering::Relaxed);
        let mut offline = None;
        for step in 0..candidates.len() {
            let index = start.wrapping_add(step) % candidates.len();
            let (node, client, _, _, known) = candidates.get(index)?;
            let online = match known {
                Some(online) => *online,
                None => {
                    context
                        .extends
                        .router()
                        .await
                        .is_online(*node, client)
                        .await
                }
            };
            if online {
                return Some((index, true));
            }
            offline.get_or_insert(index);
        }
        offline.map(|index| (index, false))
    }
}

/// The server's session reads the whole fleet and gets the long queue.
pub(crate) struct QueueSizes {
    server: String,
    server_queue: usize,
}

impl QueueSizes {
    pub(crate) fn new(server: String, server_queue: usize) -> Self {
        Self {
            server,
            server_queue,
        }
    }
}

impl FitterManager for QueueSizes {
    fn create(&self, info: Arc<ConnectInfo>, id: Id, config: ListenerConfig) -> FitterType {
        // The name alone gives nothing away: without the secret nobody gets this far with it.
        let config = if info.username().is_some_and(|name| *name == self.server) {
            Arc::new(config.as_ref().clone().max_mqueue_len(self.server_queue))
        } else {
            config
        };
        Arc::new(DefaultFitter::new(info, id, config))
    }
}
