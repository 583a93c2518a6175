//! Who asks for which chunks, and who is next. Pure: time is handed in.
//!
//! A robot has one window at a time; a new one takes the place of the old one, so no more than a window is ever
//! under way to it because of what it asks. Robots take turns, a chunk each.

use std::collections::{BTreeMap, VecDeque};

use crawler_protocol::RobotId;
use crawler_release::Want;

/// For so long the same window is not sent again, in milliseconds: the chunks are under way.
pub(crate) const SAME_AGAIN_MS: u64 = 500;

/// Chunks of a release that a robot asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pull {
    /// The rollout that they are of.
    pub(crate) rollout: i64,
    /// Which release of its plan.
    pub(crate) release: u8,
    /// The chunks of its window; a bit stands until that chunk was sent.
    pub(crate) want: Want,
}

impl Pull {
    /// The next chunk to send.
    fn next(&self) -> Option<u32> {
        self.want.indices().next()
    }

    fn is_same_window(&self, other: &Self) -> bool {
        let missing = self.want.missing;
        self.rollout == other.rollout
            && self.want
                == Want {
                    missing,
                    ..other.want
                }
    }
}

/// A robot that has asked.
#[derive(Debug)]
struct Robot {
    /// What is left of it.
    pull: Pull,
    asked_ms: u64,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(crate) struct Pulls {
    robots: BTreeMap<RobotId, Robot>,
    /// Those of whose window something is left, each once.
    turns: VecDeque<RobotId>,
}

impl Pulls {
    /// Takes in what a robot asks for. False when that is nothing, or what it has asked for a moment ago.
    pub(crate) fn want(&mut self, robot: &RobotId, pull: Pull, now_ms: u64) -> bool {
        if pull.next().is_none() {
            return false;
        }
        if let Some(before) = self.robots.get(robot) {
            let same = before.pull.is_same_window(&pull);
            if same && now_ms.saturating_sub(before.asked_ms) < SAME_AGAIN_MS {
                return false;
            }
        }
        let asked_ms = now_ms;
        let before = self.robots.insert(robot.clone(), Robot { pull, asked_ms });
        if before.is_none_or(|before| before.pull.next().is_none()) {
            self.turns.push_back(robot.clone());
        }
        true
    }

    /// How many robots wait for chunks.
    pub(crate) fn waiting(&self) -> usize {
        self.turns.len()
    }

    /// Whose turn it is, and the chunk that is next.
    pub(crate) fn front(&self) -> Option<(&RobotId, Pull, u32)> {
        let robot = self.turns.front()?;
        let pull = self.robots.get(robot)?.pull;
        Some((robot, pull, pull.next()?))
    }

    /// The chunk that was next was sent, or is none: the next robot has its turn.
    pub(crate) fn sent(&mut self) {
        let Some(robot) = self.turns.pop_front() else {
            return;
        };
        if let Some(entry) = self.robots.get_mut(&robot) {
            let missing = &mut entry.pull.want.missing;
            *missing &= missing.wrapping_sub(1);
            if entry.pull.next().is_some() {
                self.turns.push_back(robot);
            }
        }
    }

    /// The next robot has its turn; the one before comes again.
    pub(crate) fn pass(&mut self) {
        if let Some(robot) = self.turns.pop_front() {
            self.turns.push_back(robot);
        }
    }

    /// The robot whose turn it is gets nothing.
    pub(crate) fn refuse(&mut self) {
        if let Some(robot) = self.turns.pop_front() {
            self.robots.remove(&robot);
        }
    }

    /// Nobody gets anything before asking anew.
    pub(crate) fn clear(&mut self) {
        self.robots.clear();
        self.turns.clear();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use crawler_release::chunk::Part;
    use proptest::prelude::*;

    use super::*;

    fn id(n: u8) -> RobotId {
        RobotId::new(&format!("r{n}")).unwrap()
    }

    fn pull(first: u32, missing: u16) -> Pull {
        Pull {
            rollout: 1,
            release: 0,
            want: Want {
                tag: 7,
                part: Part::Image,
                first,
                missing,
            },
        }
    }

    fn drain(pulls: &mut Pulls) -> Vec<(String, u32)> {
        let mut sent = Vec::new();
        while let Some((robot, _, index)) = pulls.front() {
            sent.push((robot.to_string(), index));
            pulls.sent();
        }
        sent
    }

    #[test]
    fn robots_take_turns() {
        let mut pulls = Pulls::default();
        assert!(pulls.want(&id(1), pull(16, 0b1011), 0));
        assert!(pulls.want(&id(2), pull(0, 0b1), 0));
        assert_eq!(pulls.waiting(), 2);
        let sent = drain(&mut pulls);
        let of = |robot: &str, index| (robot.to_owned(), index);
        assert_eq!(
            sent,
            [of("r1", 16), of("r2", 0), of("r1", 17), of("r1", 19)]
        );
        assert!(!pulls.want(&id(3), pull(0, 0), 0), "it wants nothing");
        assert!(
            !pulls.want(&id(3), pull(u32::MAX, 0b10), 0),
            "there is none"
        );
    }

    #[test]
    fn a_window_is_sent_once_and_again_when_it_was_lost() {
        let mut pulls = Pulls::default();
        assert!(pulls.want(&id(1), pull(0, 0b11), 0));
        assert!(!pulls.want(&id(1), pull(0, 0b11), 10));
        assert_eq!(drain(&mut pulls).len(), 2);
        assert!(!pulls.want(&id(1), pull(0, 0b11), SAME_AGAIN_MS - 1));
        assert!(pulls.want(&id(1), pull(0, 0b10), SAME_AGAIN_MS));
        // The next window takes the place of what is left.
        assert!(pulls.want(&id(1), pull(16, 0b1), SAME_AGAIN_MS + 1));
        assert_eq!(drain(&mut pulls), [("r1".to_owned(), 16)]);
        pulls.want(&id(1), pull(32, 1), 900);
        pulls.refuse();
        assert_eq!(pulls.front(), None);
        pulls.want(&id(1), pull(32, 1), 901);
        pulls.clear();
        assert_eq!(pulls.waiting(), 0);
    }

    proptest! {
        #[test]
        fn no_more_is_sent_than_was_asked_for(
            steps in proptest::collection::vec((0_u8..4, 0_u32..4, any::<u16>(), 0_u8..4), 1..200),
        ) {
            let mut pulls = Pulls::default();
            let mut left: BTreeMap<RobotId, BTreeSet<u32>> = BTreeMap::new();
            let mut now = 0;
            for (robot, window, missing, act) in steps {
                now += 100;
                let first = window * 16;
                if act == 0 {
                    let taken = pulls.want(&id(robot), pull(first, missing), now);
                    if taken {
                        let bits = (0..16).filter(|bit| missing & (1 << bit) != 0);
                        left.insert(id(robot), bits.map(|bit| first + bit).collect());
                    }
                } else if act == 1 {
                    pulls.pass();
                } else if let Some((robot, _, index)) = pulls.front() {
                    let asked = left.get_mut(robot).expect("it has asked");
                    prop_assert!(asked.remove(&index), "{robot} has not asked for {index}");
                    pulls.sent();
                }
                let waiting = left.values().filter(|asked| !asked.is_empty()).count();
                prop_assert_eq!(pulls.waiting(), waiting);
            }
            for (robot, index) in drain(&mut pulls) {
                let robot: RobotId = robot.parse().expect("a robot");
                prop_assert!(left.get_mut(&robot).expect("it has asked").remove(&index));
            }
            prop_assert!(left.values().all(BTreeSet::is_empty));
        }
    }
}
