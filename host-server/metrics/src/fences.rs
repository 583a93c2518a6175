//! Crossings of fences.

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::registry::Registry;

use crate::Metrics;

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Label {
    kind: &'static str,
    action: &'static str,
}

/// How often robots crossed fences to where they should not be.
pub(crate) struct Crossings(Family<Label, Counter>);

impl Crossings {
    pub(crate) fn new(registry: &mut Registry) -> Self {
        let family = Family::<Label, Counter>::default();
        registry.register(
            "fence_crossings",
            "Crossings of fences to where robots should not be, by kind and action of the fence",
            family.clone(),
        );
        Self(family)
    }
}

impl Metrics {
    /// Shows a count for each kind of fence with each action: a counter that is not there before its first
    /// event has no rate at that event.
    pub fn expect_fence_crossings(&self, kinds: &[&'static str], actions: &[&'static str]) {
        for &kind in kinds {
            for &action in actions {
                let _ = self
                    .fence_crossings
                    .0
                    .get_or_create(&Label { kind, action })
                    .inc_by(0);
            }
        }
    }

    /// Counts a crossing of a fence of this kind and action to where a robot should not be.
    pub fn fence_crossing(&self, kind: &'static str, action: &'static str) {
        self.fence_crossings
            .0
            .get_or_create(&Label { kind, action })
            .inc();
    }
}
