//! Who asks for which chunks, and who is next. Pure: time is handed in.
//!
//! A robot has one window at a time; a new one takes the place of the old one, so no more than a window is ever
//! under way to it because of what it asks.
//!
//! Of a whole fleet [`OPEN`] windows are under way at a time, for as long as they are answered within [`OPEN_MS`]; the
//! others wait for their turn. What is said to robots beside it, a `stop` above all, finds a broker that has
//! [`OPEN`] windows of work to do, and not as many as there are robots. A robot keeps its turn for [`KEPT`] windows:
//! those that begin together then end, and are on trial, one after the other, which makes room for the next ones. To one
//! robot chunks go [`AT_ONCE`] at a time, and no faster than a flash writes them, so that what comes behind them is read
//! at once: a robot reads nothing while a chunk waits for its place.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crawler_protocol::RobotId;
use crawler_release::Want;

/// For so long after a window was sent it is not sent again, in milliseconds: the chunks are under way.
pub(crate) const SAME_AGAIN_MS: u64 = 500;
/// Windows that are under way at a time.
const OPEN: usize = 8;
/// A window that its robot has not answered for so long makes room for another one, whatever has become of it.
const OPEN_MS: u64 = 100;
/// Windows that a robot is sent before others have their turn: of a thousand robots that ask at once the last one
/// begins after a minute and a half, before it gives the server up.
const KEPT: u8 = 16;
/// Chunks that go to a robot one behind the other, so that they share segments of TCP.
const AT_ONCE: u8 = 4;
/// From such a burst to the next one: a flash writes a chunk in two milliseconds.
const PACE_MS: u64 = 8;

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
    /// When it has asked, or was sent something last.
    last_ms: u64,
    place: Place,
    /// Windows for which it has its turn yet.
    kept: u8,
    /// Chunks of the present burst, and before when the next one does not begin.
    burst: u8,
    next_ms: u64,
}

/// Where a robot is to be found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Its window is not under way, and waits to be: in [`Pulls::waiting`].
    Waiting,
    /// The same, from that moment on: in [`Pulls::delayed`].
    Delayed(u64),
    /// Its window is under way, and something of it is left: in [`Pulls::turns`].
    Turn,
    /// All of it was sent; it counts as under way until then: in [`Pulls::unanswered`].
    Sent(u64),
    /// It has nothing left, and was not heard of since.
    Silent,
}

/// Whose turn it is.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Turn<'a> {
    /// This robot's, and the chunk of it that is next.
    Of(&'a RobotId, Pull, u32),
    /// Nobody's before that moment.
    At(u64),
    /// Nobody's before somebody asks.
    Nobody,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(crate) struct Pulls {
    robots: BTreeMap<RobotId, Robot>,
    waiting: VecDeque<RobotId>,
    delayed: BTreeSet<(u64, RobotId)>,
    turns: VecDeque<RobotId>,
    unanswered: BTreeSet<(u64, RobotId)>,
}

impl Pulls {
    /// Takes in what a robot asks for. False when that is nothing, or what it has asked for a moment ago.
    pub(crate) fn want(&mut self, robot: &RobotId, pull: Pull, now_ms: u64) -> bool {
        if pull.next().is_none() {
            return false;
        }
        let Some(before) = self.robots.get_mut(robot) else {
            let new = Robot {
                pull,
                last_ms: now_ms,
                place: Place::Waiting,
                kept: 0,
                burst: 0,
                next_ms: 0,
            };
            self.robots.insert(robot.clone(), new);
            self.waiting.push_back(robot.clone());
            return true;
        };
        let same = before.pull.is_same_window(&pull);
        if same && now_ms.saturating_sub(before.last_ms) < SAME_AGAIN_MS {
            return false;
        }
        before.pull = pull;
        before.last_ms = now_ms;
        match before.place {
            Place::Waiting | Place::Delayed(_) | Place::Turn => return true,
            Place::Sent(until) => {
                self.unanswered.remove(&(until, robot.clone()));
                if before.kept > 0 {
                    before.place = Place::Turn;
                    self.turns.push_back(robot.clone());
                    return true;
                }
            }
            Place::Silent => {}
        }
        before.place = Place::Waiting;
        self.waiting.push_back(robot.clone());
        true
    }

    /// Whose turn it is.
    pub(crate) fn next(&mut self, now_ms: u64) -> Turn<'_> {
        self.open(now_ms);
        for _ in 0..self.turns.len() {
            let is_due = |robot: &RobotId| {
                let entry = self.robots.get(robot);
                entry.is_some_and(|entry| entry.next_ms <= now_ms)
            };
            if self.turns.front().is_some_and(is_due) {
                break;
            }
            self.turns.rotate_left(1);
        }
        if let Some(robot) = self.turns.front()
            && let Some(entry) = self.robots.get(robot)
            && entry.next_ms <= now_ms
            && let Some(index) = entry.pull.next()
        {
            return Turn::Of(robot, entry.pull, index);
        }
        let paced = self.turns.iter().filter_map(|robot| {
            let entry = self.robots.get(robot)?;
            Some(entry.next_ms)
        });
        let answered = self.unanswered.first().map(|(at, _)| *at);
        let answered = answered.filter(|_| !self.waiting.is_empty());
        let delayed = self.delayed.first().map(|(at, _)| *at);
        let at = paced.chain(answered).chain(delayed).min();
        at.map_or(Turn::Nobody, Turn::At)
    }

    /// Gives the windows that wait the places of those that were answered, or that have had theirs for long enough.
    fn open(&mut self, now_ms: u64) {
        while let Some((at, robot)) = self.unanswered.pop_first() {
            if at > now_ms {
                self.unanswered.insert((at, robot));
                break;
            }
            if let Some(entry) = self.robots.get_mut(&robot) {
                entry.place = Place::Silent;
            }
        }
        while let Some((at, robot)) = self.delayed.pop_first() {
            if at > now_ms {
                self.delayed.insert((at, robot));
                break;
            }
            if let Some(entry) = self.robots.get_mut(&robot) {
                entry.place = Place::Waiting;
                self.waiting.push_back(robot);
            }
        }
        while self.turns.len() + self.unanswered.len() < OPEN
            && let Some(robot) = self.waiting.pop_front()
        {
            if let Some(entry) = self.robots.get_mut(&robot) {
                (entry.place, entry.kept) = (Place::Turn, KEPT);
                self.turns.push_back(robot);
            }
        }
    }

    /// The chunk that was next was sent, or is none.
    pub(crate) fn sent(&mut self, now_ms: u64) {
        let Some(robot) = self.turns.front() else {
            return;
        };
        let Some(entry) = self.robots.get_mut(robot) else {
            return;
        };
        let missing = &mut entry.pull.want.missing;
        *missing &= missing.wrapping_sub(1);
        entry.last_ms = now_ms;
        entry.burst += 1;
        let is_over = entry.pull.next().is_none();
        if entry.burst < AT_ONCE && !is_over {
            return;
        }
        entry.burst = 0;
        entry.next_ms = now_ms + PACE_MS;
        if !is_over {
            self.turns.rotate_left(1);
            return;
        }
        let until = now_ms + OPEN_MS;
        entry.kept = entry.kept.saturating_sub(1);
        entry.place = Place::Sent(until);
        if let Some(robot) = self.turns.pop_front() {
            self.unanswered.insert((until, robot));
        }
    }

    /// The robot whose turn it is gets nothing before so many milliseconds have passed; another one takes its place.
    pub(crate) fn delay(&mut self, ms: u64, now_ms: u64) {
        if let Some(robot) = self.turns.pop_front()
            && let Some(entry) = self.robots.get_mut(&robot)
        {
            let at = now_ms + ms.max(1);
            entry.place = Place::Delayed(at);
            self.delayed.insert((at, robot));
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
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
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

    /// Sends what there is to send, for as long as it takes.
    fn drain(pulls: &mut Pulls, now_ms: &mut u64) -> Vec<(String, u32)> {
        let mut sent = Vec::new();
        loop {
            match pulls.next(*now_ms) {
                Turn::Of(robot, _, index) => sent.push((robot.to_string(), index)),
                Turn::At(at) => {
                    *now_ms = at;
                    continue;
                }
                Turn::Nobody => return sent,
            }
            pulls.sent(*now_ms);
        }
    }

    #[test]
    fn robots_take_turns_in_bursts() {
        let (mut pulls, mut now) = (Pulls::default(), 0);
        assert!(pulls.want(&id(1), pull(16, 0b1101_1111), 0));
        assert!(pulls.want(&id(2), pull(0, 0b1), 0));
        let of = |robot: &str, index| (robot.to_owned(), index);
        let first = [of("r1", 16), of("r1", 17), of("r1", 18), of("r1", 19)];
        let then = [of("r2", 0), of("r1", 20), of("r1", 22), of("r1", 23)];
        assert_eq!(drain(&mut pulls, &mut now), [first, then].concat());
        assert_eq!(now, PACE_MS, "the second burst waits for the flash");
        assert!(!pulls.want(&id(3), pull(0, 0), 0), "it wants nothing");
        let past = pull(u32::MAX, 0b10);
        assert!(!pulls.want(&id(3), past, 0), "there is none");
    }

    #[test]
    fn a_window_is_sent_once_and_again_when_it_was_lost() {
        let mut pulls = Pulls::default();
        assert!(pulls.want(&id(1), pull(0, 0b11), 0));
        assert!(!pulls.want(&id(1), pull(0, 0b11), 10));
        // It has waited for its turn: what counts is when it was sent.
        let mut now = 400;
        assert_eq!(drain(&mut pulls, &mut now).len(), 2);
        now = 400 + SAME_AGAIN_MS;
        assert!(!pulls.want(&id(1), pull(0, 0b11), now - 1));
        assert!(pulls.want(&id(1), pull(0, 0b10), now));
        // The next window takes the place of what is left.
        assert!(pulls.want(&id(1), pull(16, 0b1), now + 1));
        assert_eq!(drain(&mut pulls, &mut now), [("r1".to_owned(), 16)]);
        pulls.want(&id(1), pull(32, 1), now);
        now += PACE_MS;
        assert!(matches!(pulls.next(now), Turn::Of(..)));
        pulls.refuse();
        assert_eq!(pulls.next(now), Turn::Nobody);
        pulls.want(&id(1), pull(32, 1), now);
        pulls.clear();
        assert_eq!(pulls.next(now), Turn::Nobody);
    }

    #[test]
    fn of_a_whole_fleet_few_windows_are_under_way() {
        const ROBOTS: u8 = 100;
        let (mut pulls, mut now) = (Pulls::default(), 0);
        for robot in 0..ROBOTS {
            assert!(pulls.want(&id(robot), pull(0, 0xFFFF), 0));
        }
        // Everybody answers a window two milliseconds for each chunk later, and asks for the next one.
        let mut answers: BTreeSet<(u64, RobotId, u32)> = BTreeSet::new();
        let mut sent: BTreeMap<RobotId, u32> = BTreeMap::new();
        let (mut under_way, mut most, mut done) = (0, 0, 0);
        while done < u32::from(ROBOTS) * 4 {
            while let Some((at, robot, first)) = answers.first().cloned()
                && at <= now
            {
                answers.pop_first();
                under_way -= 16;
                done += 1;
                if first < 48 {
                    assert!(pulls.want(&robot, pull(first + 16, 0xFFFF), now));
                }
            }
            match pulls.next(now) {
                Turn::Of(robot, pull, _) => {
                    let robot = robot.clone();
                    under_way += 1;
                    most = most.max(under_way);
                    let count = sent.entry(robot.clone()).or_default();
                    *count += 1;
                    if count.is_multiple_of(16) {
                        answers.insert((now + 32, robot, pull.want.first));
                    }
                    pulls.sent(now);
                }
                Turn::At(_) | Turn::Nobody => now += 1,
            }
        }
        assert_eq!(most, OPEN as u32 * 16, "of 1,600 chunks that are asked for");
        assert!(sent.values().all(|count| *count == 64), "{sent:?}");
        let windows = u64::from(done) / OPEN as u64;
        assert!(now <= windows * 80, "{now} ms: nobody waits for nothing");
    }

    #[test]
    fn who_has_its_turn_keeps_it_for_a_while() {
        let (mut pulls, mut now) = (Pulls::default(), 0);
        for robot in 0..=OPEN as u8 {
            assert!(pulls.want(&id(robot), pull(0, 0b1), 0));
        }
        let last = id(OPEN as u8);
        let mut windows = 0;
        loop {
            // The others answer at once.
            let mut answers = Vec::new();
            while let Turn::Of(robot, pull, _) = pulls.next(now) {
                let robot = robot.clone();
                if robot == last {
                    assert_eq!(windows, u32::from(KEPT), "of each of the others");
                    return;
                }
                answers.push((robot, pull.want.first + 1));
                pulls.sent(now);
            }
            assert_eq!(answers.len(), OPEN);
            windows += 1;
            for (robot, first) in answers {
                assert!(pulls.want(&robot, pull(first, 0b1), now));
            }
            now += PACE_MS;
        }
    }

    #[test]
    fn who_does_not_answer_makes_room() {
        let (mut pulls, mut now) = (Pulls::default(), 0);
        for robot in 0..20 {
            assert!(pulls.want(&id(robot), pull(0, 0b1), 0));
        }
        assert_eq!(drain(&mut pulls, &mut now).len(), 20);
        assert_eq!(now, 2 * OPEN_MS);
        assert!(pulls.want(&id(0), pull(1, 0b1), now));
        assert!(matches!(pulls.next(now), Turn::Of(..)));
    }

    #[test]
    fn who_has_to_wait_for_a_limit_keeps_nobody_from_getting_anything() {
        let (mut pulls, now) = (Pulls::default(), 0);
        for robot in 0..20 {
            assert!(pulls.want(&id(robot), pull(0, 0b1), 0));
        }
        for _ in 0..19 {
            assert!(matches!(pulls.next(now), Turn::Of(..)));
            pulls.delay(60, now);
        }
        let last = id(19);
        assert_eq!(pulls.next(now), Turn::Of(&last, pull(0, 1), 0));
        pulls.sent(now);
        assert_eq!(pulls.next(now), Turn::At(60));
        assert!(matches!(pulls.next(60), Turn::Of(..)));
    }

    proptest! {
        #[test]
        fn no_more_is_sent_than_was_asked_for(
            steps in proptest::collection::vec((0_u8..20, 0_u32..4, any::<u16>(), 0_u8..4), 1..200),
        ) {
            let mut pulls = Pulls::default();
            let mut left: BTreeMap<RobotId, BTreeSet<u32>> = BTreeMap::new();
            let mut now = 0;
            for (robot, window, missing, act) in steps {
                now += 10;
                let first = window * 16;
                if act == 0 {
                    let taken = pulls.want(&id(robot), pull(first, missing), now);
                    if taken {
                        let bits = (0..16).filter(|bit| missing & (1 << bit) != 0);
                        left.insert(id(robot), bits.map(|bit| first + bit).collect());
                    }
                } else if let Turn::Of(robot, _, index) = pulls.next(now) {
                    if act == 1 {
                        pulls.delay(30, now);
                        continue;
                    }
                    let asked = left.get_mut(robot).expect("it has asked");
                    prop_assert!(asked.remove(&index), "{robot} has not asked for {index}");
                    pulls.sent(now);
                }
                prop_assert!(pulls.turns.len() + pulls.unanswered.len() <= OPEN);
            }
            for (robot, index) in drain(&mut pulls, &mut now) {
                let robot: RobotId = robot.parse().expect("a robot");
                prop_assert!(left.get_mut(&robot).expect("it has asked").remove(&index));
            }
            prop_assert!(left.values().all(BTreeSet::is_empty));
        }
    }
}
