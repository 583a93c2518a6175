//! What the metrics tell of rollouts.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crawler_metrics::Exposition;
use crawler_release::chunk::Part;
use crawler_updates::rollout::{RolloutState, UpdateState};

use crate::Rollouts;

/// Counted as it happens.
#[derive(Debug, Default)]
pub(crate) struct Numbers {
    connected: AtomicBool,
    chunks: AtomicU64,
    bytes: AtomicU64,
    patch_bytes: AtomicU64,
    patches_offered: AtomicU64,
    patches_given_up: AtomicU64,
    reports: AtomicU64,
    ignored: AtomicU64,
    failures: AtomicU64,
}

impl Numbers {
    pub(crate) fn connected(&self, connected: bool) {
        self.connected.store(connected, Ordering::Relaxed);
    }

    pub(crate) fn sent_chunk(&self, part: Part, bytes: usize) {
        self.chunks.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        if part == Part::Delta {
            self.patch_bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        }
    }

    pub(crate) fn offered_patch(&self) {
        self.patches_offered.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn gave_patch_up(&self) {
        self.patches_given_up.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn heard(&self) {
        self.reports.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn ignored(&self) {
        self.ignored.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn store_failed(&self) {
        self.failures.fetch_add(1, Ordering::Relaxed);
    }
}

/// The names under which rollouts at work are counted.
const STATES: [&str; 3] = ["running", "paused", "aborting"];

const fn name(state: RolloutState) -> Option<&'static str> {
    match state {
        RolloutState::Running => Some(STATES[0]),
        RolloutState::Paused(_) => Some(STATES[1]),
        RolloutState::Aborting => Some(STATES[2]),
        RolloutState::Aborted | RolloutState::Done => None,
    }
}

impl Rollouts {
    /// How rollouts of this server go.
    pub fn write_metrics(&self, out: &mut Exposition) {
        let now = self.now();
        let mut states: BTreeMap<&str, usize> = BTreeMap::new();
        let mut robots: BTreeMap<UpdateState, usize> = BTreeMap::new();
        for (_, one) in self.active().all() {
            let Some(state) = name(one.rollout.document().state) else {
                continue;
            };
            *states.entry(state).or_default() += 1;
            for (state, count) in one.rollout.counts(now).robots {
                *robots.entry(state).or_default() += count as usize;
            }
        }
        out.gauges(
            "terracrawler_rollouts",
            "Rollouts at work that this server carries out, by state",
            "state",
            STATES.map(|state| (state, states.get(state).copied().unwrap_or(0))),
        );
        out.gauges(
            "terracrawler_rollout_robots",
            "Robots of those rollouts, by where they stand",
            "state",
            UpdateState::ALL.map(|state| (state.name(), robots.get(&state).copied().unwrap_or(0))),
        );
        let numbers = &self.numbers;
        out.flag(
            "terracrawler_updates_connected",
            "1 while the session over which robots are updated stands; there is one while there are rollouts",
            numbers.connected.load(Ordering::Relaxed),
        );
        for (name, help, value) in [
            (
                "chunks",
                "Chunks of releases sent to robots",
                &numbers.chunks,
            ),
            ("chunk_bytes", "Bytes of those chunks", &numbers.bytes),
            (
                "delta_bytes",
                "Of those, bytes of deltas",
                &numbers.patch_bytes,
            ),
            (
                "delta_offers",
                "Offers of a release with a delta",
                &numbers.patches_offered,
            ),
            (
                "deltas_given_up",
                "Robots that asked for the image after an offer with a delta",
                &numbers.patches_given_up,
            ),
            (
                "reports",
                "Messages of robots about updates",
                &numbers.reports,
            ),
            (
                "reports_ignored",
                "Of those, messages that could not be read, were of nobody's rollout, or came too fast",
                &numbers.ignored,
            ),
            (
                "store_failures",
                "Steps of rollouts that could not be stored at once",
                &numbers.failures,
            ),
        ] {
            let value = value.load(Ordering::Relaxed) as f64;
            out.counter(&format!("terracrawler_updates_{name}"), help, value);
        }
    }
}
