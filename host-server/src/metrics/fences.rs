//! Crossings of fences.

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::registry::Registry;

use super::Metrics;
use crate::fleet::Crossing;
use crate::fleet::{FenceAction, FenceKind};

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Label {
    kind: &'static str,
    action: &'static str,
}

impl Label {
    const fn new(kind: FenceKind, action: FenceAction) -> Self {
        Self {
            kind: kind.name(),
            action: action.name(),
        }
    }
}

/// How often robots crossed fences to where they should not be.
pub(super) struct Crossings(Family<Label, Counter>);

impl Crossings {
    pub(super) fn new(registry: &mut Registry) -> Self {
        let family = Family::<Label, Counter>::default();
        registry.register(
            "fence_crossings",
            "Crossings of fences to where robots should not be, by kind and action of the fence",
            family.clone(),
        );
        // A counter that is not there before its first event has no rate at that event.
        for kind in FenceKind::ALL {
            for action in FenceAction::ALL {
                let _ = family.get_or_create(&Label::new(kind, action)).inc_by(0);
            }
        }
        Self(family)
    }
}

impl Metrics {
    /// Counts a crossing, unless it is the way back.
    pub(crate) fn fence_crossing(&self, crossing: &Crossing) {
        if !crossing.back {
            let label = Label::new(crossing.fence.kind, crossing.fence.action);
            self.fence_crossings.0.get_or_create(&label).inc();
        }
    }
}
