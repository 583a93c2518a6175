//! Patches: what makes the image of a release out of the program that a robot runs, where that is of another release.
//! Pure: time is handed in.
//!
//! A patch is made once for a pair, beside everything else and one at a time. Offers to robots that it is for wait until it
//! is there, but for ten seconds at most: it takes half a second for a program of 600 KB, and an offer that did not
//! wait would have the first robots, of all, receive ten times as much. An offer that has waited goes out without one; so
//! do those for pairs of which there is none that is worth it, which is not tried again while the rollout lasts.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crawler_protocol::{ReleaseId, RobotId, UpdateDelta};
use crawler_release::chunk::PAYLOAD;
use crawler_updates::rollout::BuildId;

/// How long an offer waits for a patch, in milliseconds.
pub(crate) const WAIT_MS: u64 = 10_000;
/// Most pairs, and most bytes of all patches together. What is beyond goes without.
const PAIRS: usize = 64;
const BYTES: usize = 32 * 1024 * 1024;

/// What a patch is between.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Pair {
    /// The build that runs.
    pub(crate) from: BuildId,
    /// The release that it makes.
    pub(crate) to: ReleaseId,
}

#[derive(Debug)]
enum State {
    Making,
    Made(Arc<[u8]>),
    /// There is none, or none that is worth it.
    Nothing,
}

/// A patch that a robot was offered.
#[derive(Debug)]
struct Offered {
    release: ReleaseId,
    patch: Arc<[u8]>,
    given_up: bool,
}

/// What to offer a robot.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Offer {
    /// The release, with this patch or without one.
    Now(Option<UpdateDelta>),
    /// Nothing yet: a patch is being made, or has to be (`begin`).
    Later { begin: bool },
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(crate) struct Patches {
    pairs: BTreeMap<Pair, State>,
    offered: BTreeMap<RobotId, Offered>,
    /// Robots whose offer waits, and since when.
    waiting: BTreeMap<RobotId, u64>,
}

impl Patches {
    /// What a robot is offered now. One that is not offered anything is waiting from then on.
    pub(crate) fn offer(&mut self, robot: &RobotId, pair: &Pair, now_ms: u64) -> Offer {
        let patch = match self.pairs.get(pair) {
            Some(State::Made(patch)) => Some(Arc::clone(patch)),
            Some(State::Making) => {
                let since = *self.waiting.entry(robot.clone()).or_insert(now_ms);
                if now_ms.saturating_sub(since) < WAIT_MS {
                    return Offer::Later { begin: false };
                }
                None
            }
            None if self.has_room() => {
                self.pairs.insert(pair.clone(), State::Making);
                self.waiting.entry(robot.clone()).or_insert(now_ms);
                return Offer::Later { begin: true };
            }
            Some(State::Nothing) | None => None,
        };
        self.waiting.remove(robot);
        self.offered.remove(robot);
        let base = pair.from.as_str().parse();
        let (Some(patch), Ok(base)) = (patch, base) else {
            return Offer::Now(None);
        };
        let bytes = patch.len() as u32;
        let offered = Offered {
            release: pair.to,
            patch,
            given_up: false,
        };
        self.offered.insert(robot.clone(), offered);
        Offer::Now(Some(UpdateDelta { base, bytes }))
    }

    fn has_room(&self) -> bool {
        let bytes: usize = self
            .pairs
            .values()
            .map(|state| match state {
                State::Made(patch) => patch.len(),
                State::Making | State::Nothing => 0,
            })
            .sum();
        self.pairs.len() < PAIRS && bytes < BYTES
    }

    /// A patch is made, or there is none.
    pub(crate) fn made(&mut self, pair: &Pair, patch: Option<Vec<u8>>) {
        // Otherwise nobody needs it any more.
        if let Some(state) = self.pairs.get_mut(pair) {
            *state = patch.map_or(State::Nothing, |patch| State::Made(patch.into()));
        }
    }

    /// The robots whose offer waits.
    pub(crate) fn waiting(&self) -> BTreeSet<RobotId> {
        self.waiting.keys().cloned().collect()
    }

    /// Whether an offer has waited for long enough.
    pub(crate) fn is_due(&self, now_ms: u64) -> bool {
        let mut waiting = self.waiting.values();
        waiting.any(|since| now_ms.saturating_sub(*since) >= WAIT_MS)
    }

    /// Of the robots whose offer waits, these do. The others are not to be offered anything any more.
    pub(crate) fn keep_waiting(&mut self, robots: &BTreeSet<RobotId>) {
        self.waiting.retain(|robot, _| robots.contains(robot));
    }

    /// Whether a robot was offered a patch of the release of that tag.
    pub(crate) fn has(&self, robot: &RobotId, tag: u32) -> bool {
        let offered = self.offered.get(robot);
        offered.is_some_and(|offered| offered.release.tag() == tag)
    }

    /// A robot asks for the image of the release of that tag. Whether it has given up a patch by that.
    pub(crate) fn give_up(&mut self, robot: &RobotId, tag: u32) -> bool {
        let offered = self.offered.get_mut(robot);
        offered.is_some_and(|offered| {
            offered.release.tag() == tag && !std::mem::replace(&mut offered.given_up, true)
        })
    }

    /// What chunk `index` of the patch that a robot was offered holds; `None` when there is no such chunk.
    pub(crate) fn payload(
        &self,
        robot: &RobotId,
        release: ReleaseId,
        index: u32,
    ) -> Option<Vec<u8>> {
        let offered = self.offered.get(robot)?;
        let patch = (offered.release == release).then_some(&offered.patch)?;
        let mut chunks = patch.chunks(PAYLOAD);
        chunks.nth(index as usize).map(<[u8]>::to_vec)
    }

    /// Forgets what is of no release that `is_needed`.
    pub(crate) fn keep(&mut self, is_needed: impl Fn(ReleaseId) -> bool) {
        self.pairs.retain(|pair, _| is_needed(pair.to));
        self.offered.retain(|_, offered| is_needed(offered.release));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RELEASE: ReleaseId = ReleaseId::new([1, 2, 3, 4, 5, 6, 7, 8]);

    fn pair(from: &str) -> Pair {
        Pair {
            from: BuildId::new(from).expect("a build"),
            to: RELEASE,
        }
    }

    fn robot(n: u32) -> RobotId {
        RobotId::new(&format!("r{n}")).expect("a name")
    }

    fn with(bytes: u32) -> Offer {
        let base = "old".parse().expect("a build");
        Offer::Now(Some(UpdateDelta { base, bytes }))
    }

    #[test]
    fn offers_wait_for_a_patch_that_is_made_once() {
        let mut patches = Patches::default();
        let begun = Offer::Later { begin: true };
        let waits = Offer::Later { begin: false };
        assert_eq!(patches.offer(&robot(1), &pair("old"), 5), begun);
        assert_eq!(patches.offer(&robot(2), &pair("old"), 6), waits);
        assert_eq!(patches.offer(&robot(1), &pair("old"), 7), waits);
        assert_eq!(patches.waiting(), [robot(1), robot(2)].into());
        patches.made(&pair("old"), Some(vec![7; 1_500]));
        assert_eq!(patches.offer(&robot(1), &pair("old"), 8), with(1_500));
        assert_eq!(patches.waiting(), [robot(2)].into());
        let payload = |index| patches.payload(&robot(1), RELEASE, index);
        assert_eq!(payload(0).map(|bytes| bytes.len()), Some(1_024));
        assert_eq!(payload(1), Some(vec![7; 476]));
        assert_eq!((payload(2), payload(u32::MAX)), (None, None));
        assert!(patches.has(&robot(1), RELEASE.tag()));
        assert!(!patches.has(&robot(2), RELEASE.tag()));
        assert!(!patches.has(&robot(1), 9));
        // Given up once, and whole from then on until it is offered again.
        assert!(!patches.give_up(&robot(2), RELEASE.tag()));
        assert!(!patches.give_up(&robot(1), 9));
        assert!(patches.give_up(&robot(1), RELEASE.tag()));
        assert!(!patches.give_up(&robot(1), RELEASE.tag()));
        patches.keep_waiting(&BTreeSet::new());
        assert!(patches.waiting().is_empty());
        patches.keep(|_| false);
        assert!(!patches.has(&robot(1), RELEASE.tag()));
        assert_eq!(patches.offer(&robot(1), &pair("old"), 9), begun);
    }

    #[test]
    fn no_offer_waits_for_long_and_what_is_none_is_not_tried_again() {
        let mut patches = Patches::default();
        patches.offer(&robot(1), &pair("old"), 100);
        assert!(!patches.is_due(WAIT_MS + 99));
        assert!(patches.is_due(WAIT_MS + 100));
        let offer = patches.offer(&robot(1), &pair("old"), WAIT_MS + 100);
        assert_eq!(offer, Offer::Now(None));
        assert!(patches.waiting().is_empty());
        // One that comes later has its own time.
        let offer = patches.offer(&robot(2), &pair("old"), WAIT_MS + 200);
        assert_eq!(offer, Offer::Later { begin: false });
        patches.made(&pair("old"), None);
        for now in [WAIT_MS + 300, 10 * WAIT_MS] {
            let offer = patches.offer(&robot(2), &pair("old"), now);
            assert_eq!(offer, Offer::Now(None));
        }
        // What nobody asked for is not kept.
        patches.made(&pair("other"), Some(vec![1]));
        let offer = patches.offer(&robot(2), &pair("other"), 1);
        assert_eq!(offer, Offer::Later { begin: true });
    }

    #[test]
    fn there_are_limits() {
        let mut patches = Patches::default();
        for n in 0..PAIRS {
            let offer = patches.offer(&robot(0), &pair(&format!("b{n}")), 0);
            assert_eq!(offer, Offer::Later { begin: true });
        }
        let offer = patches.offer(&robot(0), &pair("more"), 0);
        assert_eq!(offer, Offer::Now(None));
        let mut patches = Patches::default();
        patches.offer(&robot(0), &pair("old"), 0);
        patches.made(&pair("old"), Some(vec![0; BYTES]));
        let offer = patches.offer(&robot(0), &pair("more"), 0);
        assert_eq!(offer, Offer::Now(None));
        assert_eq!(
            patches.offer(&robot(0), &pair("old"), 0),
            with(BYTES as u32)
        );
    }
}
