//! Movers at work: obstacles that go round on their paths and push robots aside.
//!
//! A mover advances by its speed in every step, unless a robot in its way cannot give way: then
//! it waits. Whether one can is judged from published state alone, by every replica of a world
//! alike, so movers need not be exchanged between shards.

use super::arena::{Arena, Mover, Solid};
use super::geometry::Vec2;

/// All movers of an arena.
#[derive(Debug, Clone, Default)]
pub(crate) struct Movers {
    all: Vec<Moving>,
    /// Ways that robots have to make room, found when a mover was let on: robot and displacement.
    pub(crate) ways: Vec<(u32, Vec2)>,
}

#[derive(Debug, Clone)]
struct Moving {
    mover: Mover,
    length: f64,
    /// Metres of the path since the start, modulo its length.
    way: f64,
    /// The same a step before.
    was: f64,
    /// At the end of the last step.
    now: Solid,
    /// At the end of this one.
    next: Solid,
    /// Metres from the centre beyond which it does not reach.
    around: f32,
}

impl Movers {
    pub(crate) fn new(arena: &Arena) -> Self {
        let moving = |mover: &Mover| {
            let now = Solid::new(&mover.body);
            Moving {
                mover: mover.clone(),
                length: f64::from(mover.length()),
                way: 0.0,
                was: 0.0,
                now,
                next: now,
                around: now.reach(),
            }
        };
        Self {
            all: arena.movers.iter().map(moving).collect(),
            ways: Vec::new(),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.all.len()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Fastest of them, metres per second.
    pub(crate) fn top_speed(&self) -> f32 {
        self.all
            .iter()
            .fold(0.0, |top, one| top.max(one.mover.speed))
    }

    /// Where mover `k` is.
    pub(crate) fn now(&self, k: usize) -> &Solid {
        &self.all[k].now
    }

    /// Where mover `k` goes in this step, or stays.
    pub(crate) fn next(&self, k: usize) -> &Solid {
        &self.all[k].next
    }

    /// Metres from the centre of mover `k` beyond which it does not reach.
    pub(crate) fn around(&self, k: usize) -> f32 {
        self.all[k].around
    }

    /// Metres mover `k` has gone on its path, modulo its length.
    pub(crate) fn way(&self, k: usize) -> f64 {
        self.all[k].way
    }

    /// Puts all movers where they were when they had gone so far. `None` when one cannot have.
    pub(crate) fn restore(&mut self, ways: &[f64]) -> Option<()> {
        let sound = |(one, way): (&Moving, &f64)| (0.0..=one.length).contains(way);
        if ways.len() != self.all.len() || !self.all.iter().zip(ways).all(sound) {
            return None;
        }
        for (one, &way) in self.all.iter_mut().zip(ways) {
            one.way = way;
            one.now = one.now.moved_to(one.place());
            one.next = one.now;
        }
        Some(())
    }

    /// Velocity of mover `k` in this step, metres per second.
    pub(crate) fn velocity(&self, k: usize, dt: f32) -> Vec2 {
        let one = &self.all[k];
        one.next.centre().minus(one.now.centre()).times(1.0 / dt)
    }

    /// Lets all of them intend to advance by a step.
    pub(crate) fn intend(&mut self, dt: f32) {
        self.ways.clear();
        for one in &mut self.all {
            one.now = one.next;
            one.was = one.way;
            one.way = (one.way + f64::from(one.mover.speed) * f64::from(dt)) % one.length;
            one.next = one.now.moved_to(one.place());
        }
    }

    /// Lets mover `k` wait in this step after all.
    pub(crate) fn wait(&mut self, k: usize) {
        let one = &mut self.all[k];
        one.way = one.was;
        one.next = one.now;
    }

    /// Brings all to where they are at the end of the step.
    pub(crate) fn arrive(&mut self) {
        for one in &mut self.all {
            one.now = one.next;
        }
    }
}

impl Moving {
    fn place(&self) -> Vec2 {
        let [x, y] = self.mover.at(self.way as f32);
        Vec2::new(x, y)
    }
}
