//! `patrol`: round by a list of places, spread along the way.
//!
//! A robot begins with the place that is nearest to it. It says how much of the round is behind it, and
//! takes its pace from the robots of the same round that it hears: with `a` as the way to the next one
//! ahead and `b` as that to the last one behind it goes at `2 a / (a + b)` of its speed, at most all of it
//! and at least [`SLOWEST`]. Equal gaps are a fixed point, and a robot that is too near to the one ahead
//! falls back, until the gaps are equal or the two do not hear each other any more.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, Places, Pose, Says};

use super::{MissionNews, Scene, Wish};
use crate::motion::angle::{length, millimetres};

/// Least share of the speed.
const SLOWEST: f32 = 0.3;
/// Time between two looks at the others: they are told about as often.
const ROUND: Duration = Duration::from_millis(500);
/// What a way to a place may take in any case.
const LEAST: Duration = Duration::from_secs(20);
/// And beside that so many times the straight way at full speed: the slowest pace, and detours.
const TIMES: f32 = 8.0;
/// On a way there and back on one line robots that hear each other keep this far to the right, in metres,
const LANE: f32 = 0.25;
/// and aim at this much of that lane ahead of them.
const LOOK: f32 = 0.6;
/// The whole round, in what neighbours are told.
const WHOLE: i32 = 1_000;

/// A robot on patrol.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Patrol {
    waypoints: Places,
    /// After how many rounds it is over; 0 is never.
    laps: u16,
    /// Stands for the waypoints where only sameness counts.
    route: i32,
    /// The place it is on its way to.
    next: u8,
    /// Places it has been to, those that it has given up included.
    visited: u32,
    /// When it gives that up; `None` while the way has not begun.
    deadline: Option<Instant>,
    /// Metres of a round.
    length: f32,
    /// Metres of the round before the place that it comes from.
    before: f32,
    /// Metres from there to the next one.
    leg: f32,
    /// How much of the round is behind it, in thousandths.
    progress: i32,
    /// Share of the speed.
    pace: f32,
    /// Whether it hears others on the same round.
    company: bool,
    /// Where it goes at the moment.
    aim: Option<[f32; 2]>,
    looked: Option<Instant>,
}

impl Patrol {
    pub(super) fn new(waypoints: Places, laps: u16, pose: &Pose) -> Self {
        let places = waypoints.as_slice();
        let away = |place: &[f32; 2]| {
            let [dx, dy] = [place[0] - pose.x, place[1] - pose.y];
            dx * dx + dy * dy
        };
        let nearest = (0_u8..)
            .zip(places)
            .min_by(|(_, a), (_, b)| away(a).total_cmp(&away(b)));
        let mut patrol = Self {
            waypoints,
            laps,
            route: route(places),
            next: nearest.map_or(0, |(index, _)| index),
            visited: 0,
            deadline: None,
            length: 0.0,
            before: 0.0,
            leg: 0.0,
            progress: 0,
            pace: 1.0,
            company: false,
            aim: None,
            looked: None,
        };
        patrol.measure();
        patrol
    }

    pub(super) fn says(&self) -> Says {
        let done = self.rounds().min(i32::MAX as u32) as i32;
        Says::new(BehaviourName::Patrol, &[self.route, self.progress, done])
    }

    pub(super) const fn destination(&self) -> Option<[f32; 2]> {
        self.aim
    }

    /// Where a robot at `pose` goes for the next place: there, or along its lane.
    fn aim(&self, pose: &Pose) -> Option<[f32; 2]> {
        let places = self.waypoints.as_slice();
        let place = *places.get(usize::from(self.next))?;
        if !self.company || places.len() > 2 || self.leg < LANE {
            return Some(place);
        }
        let from = *places.get(usize::from(self.previous()))?;
        let along = [0, 1].map(|axis| (place[axis] - from[axis]) / self.leg);
        let [x, y] = along;
        let done = (pose.x - from[0]) * x + (pose.y - from[1]) * y;
        let to = (done + LOOK).clamp(0.0, self.leg);
        Some([from[0] + x * to + y * LANE, from[1] + y * to - x * LANE])
    }

    pub(super) fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        self.aim = self.aim(scene.pose).filter(|_| !self.is_over());
        let Some(place) = self.aim else {
            return (Wish::Done, None);
        };
        let to = [place[0] - scene.pose.x, place[1] - scene.pose.y];
        // In metres, to the millimetre.
        let away = || length(to.map(millimetres)) as f32 * 0.001;
        let Some(deadline) = self.deadline else {
            let seconds = TIMES * away() / scene.speed.max(0.01);
            // Saturating cast.
            let span = LEAST + Duration::from_millis((seconds * 1_000.0) as u64);
            self.deadline = Some(scene.now + span);
            return (Wish::Place(place, self.pace), None);
        };
        if scene.now >= deadline {
            let skipped = MissionNews::Skipped(self.next + 1);
            self.arrived();
            return (Wish::Rest, Some(skipped));
        }
        if self.looked.is_none_or(|at| scene.now - at >= ROUND) {
            self.looked = Some(scene.now);
            let along = self.before + (self.leg - away()).max(0.0);
            self.progress = (WHOLE as f32 * along / self.length) as i32 % WHOLE;
            self.look_around(scene);
        }
        (Wish::Place(place, self.pace), None)
    }

    /// Goes on to the place after this one.
    pub(super) fn arrived(&mut self) {
        self.visited = self.visited.saturating_add(1);
        self.next = (self.next + 1) % self.waypoints.count().max(1);
        self.deadline = None;
        self.measure();
    }

    /// Rounds behind it. The first place ends none: it is where the first round begins.
    fn rounds(&self) -> u32 {
        self.visited.saturating_sub(1) / u32::from(self.waypoints.count().max(1))
    }

    fn is_over(&self) -> bool {
        self.laps > 0 && self.rounds() >= u32::from(self.laps)
    }

    fn previous(&self) -> u8 {
        self.next
            .checked_sub(1)
            .unwrap_or(self.waypoints.count().saturating_sub(1))
    }

    /// Measures the round, and where on it the way to the next place is.
    fn measure(&mut self) {
        let places = self.waypoints.as_slice();
        let from = self.previous();
        let (mut before, mut length) = (0.0, 0.0);
        let ends = places.iter().cycle().skip(1);
        for (index, (a, b)) in (0_u8..).zip(places.iter().zip(ends)) {
            let leg = libm::hypotf(b[0] - a[0], b[1] - a[1]);
            if index == from {
                before = length;
                self.leg = leg;
            }
            length += leg;
        }
        self.before = before;
        // All in one place would be no round.
        self.length = length.max(0.01);
    }

    /// Takes the pace from those who are on the same round.
    fn look_around(&mut self, scene: &Scene<'_>) {
        let (mut ahead, mut behind) = (WHOLE, WHOLE);
        self.company = false;
        for other in scene.near {
            let said = other.says.as_ref();
            let said = said.and_then(|says| says.by(BehaviourName::Patrol));
            let Some([route, progress, _]) = said else {
                continue;
            };
            if *route != self.route || !(0..WHOLE).contains(progress) {
                continue;
            }
            self.company = true;
            let gap = (progress - self.progress).rem_euclid(WHOLE);
            // Of two at one place the one with the larger name is ahead.
            let gap = if gap == 0 && other.who < scene.own {
                WHOLE
            } else {
                gap
            };
            ahead = ahead.min(gap);
            behind = behind.min(WHOLE - gap);
        }
        let share = 2.0 * ahead as f32 / (ahead + behind).max(1) as f32;
        self.pace = share.clamp(SLOWEST, 1.0);
    }
}

/// FNV-1a of the coordinates.
fn route(places: &[[f32; 2]]) -> i32 {
    let bytes = places
        .iter()
        .flatten()
        .flat_map(|along| along.to_le_bytes());
    crate::neighbours::hash(bytes) as i32
}
