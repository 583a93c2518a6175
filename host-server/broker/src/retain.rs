//! Retained messages, in memory.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use async_trait::async_trait;
use rmqtt::retain::{DefaultRetainStorage, RetainStorage};
use rmqtt::types::{Retain, TopicFilter, TopicName};

use super::GuardCounters;

/// Status and parameters of 10,000 robots, and as much again.
const MAX_RETAINED: isize = 40_000;

/// The broker's own storage, switched on and bounded. The guard has already refused to retain
/// anything but what the contract retains.
pub(crate) struct Retained {
    inner: DefaultRetainStorage,
    counters: Arc<GuardCounters>,
}

impl Retained {
    pub(crate) fn new(counters: Arc<GuardCounters>) -> Self {
        Self {
            inner: DefaultRetainStorage::new(),
            counters,
        }
    }
}

#[async_trait]
impl RetainStorage for Retained {
    fn enable(&self) -> bool {
        true
    }

    async fn set(
        &self,
        topic: &TopicName,
        retain: Retain,
        _expiry_interval: Option<Duration>,
    ) -> rmqtt::Result<()> {
        let clears = retain.publish.payload.is_empty();
        if !clears
            && self.inner.count().await >= MAX_RETAINED
            && self.inner.get_message(topic).await?.is_empty()
        {
            // An error here would end the publisher's session; the message itself has gone out.
            self.counters.not_retained.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        }
        // The interval handed in falls back to the broker's default of five minutes. A status
        // stays until it is replaced, unless its publisher asked for an end.
        let expiry = retain
            .publish
            .properties
            .as_ref()
            .and_then(|properties| properties.message_expiry_interval)
            .map(|seconds| Duration::from_secs(u64::from(seconds.get())));
        self.inner.set_with_timeout(topic, retain, expiry).await
    }

    async fn get(&self, filter: &TopicFilter) -> rmqtt::Result<Vec<(TopicName, Retain)>> {
        self.inner.get_message(filter).await
    }

    async fn count(&self) -> isize {
        self.inner.count().await
    }

    async fn max(&self) -> isize {
        MAX_RETAINED
    }
}
