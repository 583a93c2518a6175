//! `allocate`: tasks to robots, by an auction without an auctioneer.
//!
//! A robot without a task claims the one that it is cheaper for than whoever has it as far as it knows: cost
//! is its distance. For each task the lowest bid wins, of equal ones that of the smaller name; whoever is
//! outbid looks for another. Robots pass on what they know of one task at a time, news first, so that winners
//! are known beyond who hears whom directly (CBAA: Choi, Brunet and How, "Consensus-based decentralized auctions
//! for robust task allocation", IEEE TRO 25(4), 2009). While costs do not change, the outcome is that of the
//! auction that always gives the cheapest pair of what is left: at least half of the best score there is.
//!
//! What a winner says has a number that rises with every time; who passes it on leaves it. A bid whose
//! number has not risen for [`Allocate::lasts`] is that of a robot that is lost: it is dropped, and taken
//! back only with a higher number, so that it does not come round again from somebody who is slower to forget.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, MAX_PLACES, Places, Says};

use super::{MissionNews, Scene, Wish};
use crate::motion::angle::{length, millimetres};

/// Time between two rounds: neighbours are told about as often.
const ROUND: Duration = Duration::from_millis(500);
/// What a way to a task may take in any case.
const LEAST: Duration = Duration::from_secs(20);
/// And beside that so many times the straight way at full speed.
const TIMES: f32 = 8.0;
/// Within so many millimetres of its task a robot that has been there stays.
const STAY_MM: i32 = 500;
/// Bids that are remembered as those of robots that are lost.
const FORGOTTEN: usize = 8;

/// Who has a task, as far as is known.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Bid {
    winner: u32,
    /// In centimetres.
    cost: u16,
    /// Rises each time that the winner says it.
    beat: u8,
    /// When that was heard first.
    heard: Instant,
}

/// A robot in an auction.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Allocate {
    tasks: Places,
    /// Stands for the tasks where only sameness counts.
    list: i32,
    own: u32,
    bids: [Option<Bid>; MAX_PLACES],
    /// Tasks of which something is known that it has not said yet: a bit for each.
    news: u8,
    /// Tasks that it could not reach: a bit for each.
    given_up: u8,
    /// The task that it has.
    mine: Option<u8>,
    /// What it says.
    tells: Option<u8>,
    beat: u8,
    /// When it said last that it has its task.
    beaten: Option<Instant>,
    forgotten: [Option<(u32, u8, Instant)>; FORGOTTEN],
    /// Where the next one that is forgotten goes.
    oldest: u8,
    /// When it gives up the way to its task.
    deadline: Option<Instant>,
    /// Whether it has been at its task.
    there: bool,
    looked: Option<Instant>,
    /// Draws what to say, so that whoever listens every so often hears all of it.
    draw: u32,
}

impl Allocate {
    pub(super) fn new(tasks: Places) -> Self {
        let bytes = tasks.as_slice().iter().flatten();
        let hash = crate::neighbours::hash(bytes.flat_map(|along| along.to_le_bytes()));
        Self {
            tasks,
            list: (hash & 0xFFFF) as i32,
            own: 0,
            bids: [None; MAX_PLACES],
            news: 0,
            given_up: 0,
            mine: None,
            tells: None,
            beat: 0,
            beaten: None,
            forgotten: [None; FORGOTTEN],
            oldest: 0,
            deadline: None,
            there: false,
            looked: None,
            draw: 0,
        }
    }

    /// `[list, task and number, cost, winner]`; without the last three while nothing is known.
    pub(super) fn says(&self) -> Says {
        let bid = self.tells.and_then(|task| Some((task, self.bid(task)?)));
        match bid {
            Some((task, bid)) => Says::new(
                BehaviourName::Allocate,
                &[
                    self.list,
                    i32::from(task) << 8 | i32::from(bid.beat),
                    i32::from(bid.cost),
                    bid.winner as i32,
                ],
            ),
            None => Says::new(BehaviourName::Allocate, &[self.list]),
        }
    }

    /// The place of the task that it has, until it has been there.
    pub(super) fn destination(&self) -> Option<[f32; 2]> {
        let place = self.place(self.mine?)?;
        (!self.there).then_some(place)
    }

    pub(super) fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        let mut news = None;
        if self.looked.is_none_or(|at| scene.now - at >= ROUND) {
            self.looked = Some(scene.now);
            news = self.round(scene);
        }
        let Some(place) = self.mine.and_then(|task| self.place(task)) else {
            return (Wish::Rest, news);
        };
        if self.there && distance(scene, place) <= STAY_MM {
            return (Wish::Rest, news);
        }
        self.there = false;
        (Wish::Place(place, 1.0), news)
    }

    pub(super) const fn arrived(&mut self) {
        self.there = true;
        self.deadline = None;
    }

    /// Time in which the number of a winner rises wherever somebody knows of it, unless it is lost: so many
    /// times what it takes to say all that is known.
    fn lasts(&self) -> Duration {
        ROUND * (5 * u32::from(self.tasks.count().max(3)))
    }

    fn round(&mut self, scene: &Scene<'_>) -> Option<MissionNews> {
        if self.own != scene.own {
            self.own = scene.own;
            self.draw = scene.own;
        }
        for other in scene.near {
            let said = other.says.as_ref();
            let said = said.and_then(|says| says.by(BehaviourName::Allocate));
            if let Some([list, task, cost, winner]) = said
                && *list == self.list
            {
                self.hear(*task, *cost, *winner as u32, scene.now);
            }
        }
        self.forget(scene.now);
        // Outbid, or told so.
        let holds = |task: &u8| self.bid(*task).is_some_and(|bid| bid.winner == self.own);
        let before = self.mine;
        self.mine = self.mine.filter(holds);
        if self.mine.is_none() && before.is_some() {
            self.deadline = None;
            self.there = false;
        }
        let news = self.give_up(scene.now);
        if self.mine.is_none() {
            self.claim(scene);
        }
        self.tell(scene);
        news
    }

    /// Takes in what somebody says of a task.
    fn hear(&mut self, word: i32, cost: i32, winner: u32, now: Instant) {
        let (Ok(task), beat) = (u8::try_from(word >> 8), word as u8) else {
            return;
        };
        let Ok(cost) = u16::try_from(cost) else {
            return;
        };
        if winner == self.own {
            // An echo, or what it said before it started anew.
            if is_newer(beat, self.beat) {
                self.beat = beat;
            }
            return;
        }
        if task >= self.tasks.count() || self.is_old(winner, beat, now) {
            return;
        }
        let new = Bid {
            winner,
            cost,
            beat,
            heard: now,
        };
        let held = (0..self.tasks.count()).find(|task| {
            let bid = self.bid(*task);
            bid.is_some_and(|bid| bid.winner == winner)
        });
        if let Some(held) = held {
            // Of what one robot says of itself the newest counts.
            let known = self.bid(held).is_some_and(|bid| !is_newer(beat, bid.beat));
            if known {
                return;
            }
            self.put(held, None);
        }
        let beaten = self.bid(task).is_none_or(|bid| {
            // The one that it replaces in any case is gone already.
            (cost, winner) < (bid.cost, bid.winner)
        });
        if beaten {
            self.put(task, Some(new));
            self.news |= 1 << task;
        }
    }

    /// Drops the bids of robots that are lost.
    fn forget(&mut self, now: Instant) {
        let lasts = self.lasts();
        for task in 0..self.tasks.count() {
            let lost = self.bid(task);
            let lost = lost.filter(|bid| bid.winner != self.own && now - bid.heard > lasts);
            if let Some(lost) = lost {
                self.put(task, None);
                let place = usize::from(self.oldest) % FORGOTTEN;
                if let Some(place) = self.forgotten.get_mut(place) {
                    *place = Some((lost.winner, lost.beat, now));
                }
                self.oldest = self.oldest.wrapping_add(1);
            }
        }
    }

    /// Whether that is what a robot said that was lost since. Who is slow to forget has done so by three times
    /// the time that it takes; a robot that has started anew counts from the beginning.
    fn is_old(&self, winner: u32, beat: u8, now: Instant) -> bool {
        let lasts = self.lasts() * 3;
        let mut lost = self.forgotten.iter().flatten();
        lost.any(|(who, last, at)| *who == winner && !is_newer(beat, *last) && now - *at <= lasts)
    }

    /// Leaves a task that takes too long to reach to others.
    fn give_up(&mut self, now: Instant) -> Option<MissionNews> {
        let task = self.mine?;
        self.deadline.filter(|deadline| now >= *deadline)?;
        self.deadline = None;
        self.mine = None;
        self.given_up |= 1 << task;
        self.put(task, None);
        Some(MissionNews::Skipped(task + 1))
    }

    /// Claims the nearest task of those for which it is the best, as far as it knows.
    fn claim(&mut self, scene: &Scene<'_>) {
        let mut best: Option<(u16, u8, i32)> = None;
        for task in 0..self.tasks.count() {
            let Some(place) = self.place(task) else {
                continue;
            };
            let away = distance(scene, place);
            let cost = centimetres(away);
            let wins = self
                .bid(task)
                .is_none_or(|bid| (cost, self.own) < (bid.cost, bid.winner));
            let tried = self.given_up & 1 << task != 0;
            if wins && !tried && best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, task, away));
            }
        }
        if let Some((cost, task, away)) = best {
            self.mine = Some(task);
            self.there = false;
            let seconds = TIMES * (away as f32 * 0.001) / scene.speed.max(0.01);
            // Saturating cast.
            let span = LEAST + Duration::from_millis((seconds * 1_000.0) as u64);
            self.deadline = Some(scene.now + span);
            self.say_mine(task, cost, scene.now);
        }
    }

    /// Chooses what to say until the next round.
    fn tell(&mut self, scene: &Scene<'_>) {
        let due = ROUND * u32::from(self.tasks.count());
        if let Some(task) = self.mine
            && self.beaten.is_none_or(|at| scene.now - at >= due)
            && let (Some(place), Some(bid)) = (self.place(task), self.bid(task))
        {
            // The nearer it is, the less it can be outbid.
            let cost = centimetres(distance(scene, place)).min(bid.cost);
            self.say_mine(task, cost, scene.now);
        }
        let known = (0..self.tasks.count()).filter(|task| self.bid(*task).is_some());
        let known = known.fold(0_u8, |all, task| all | 1 << task);
        let new = self.news & known;
        let of = if new == 0 { known } else { new };
        self.draw = self
            .draw
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        // At most eight.
        let nth = (self.draw >> 16) % of.count_ones().max(1);
        let mut told = (0..self.tasks.count()).filter(|task| of & 1 << task != 0);
        self.tells = told.nth(nth as usize);
        self.news = new & !self.tells.map_or(0, |task| 1 << task);
    }

    fn say_mine(&mut self, task: u8, cost: u16, now: Instant) {
        self.beat = self.beat.wrapping_add(1);
        self.beaten = Some(now);
        self.put(
            task,
            Some(Bid {
                winner: self.own,
                cost,
                beat: self.beat,
                heard: now,
            }),
        );
        self.news |= 1 << task;
    }

    fn bid(&self, task: u8) -> Option<Bid> {
        self.bids.get(usize::from(task)).copied().flatten()
    }

    fn put(&mut self, task: u8, bid: Option<Bid>) {
        if let Some(place) = self.bids.get_mut(usize::from(task)) {
            *place = bid;
        }
    }

    fn place(&self, task: u8) -> Option<[f32; 2]> {
        self.tasks.as_slice().get(usize::from(task)).copied()
    }
}

/// Whether number `a` comes after `b`: they go round, and no two that meet are half a round apart.
const fn is_newer(a: u8, b: u8) -> bool {
    let ahead = a.wrapping_sub(b);
    ahead != 0 && ahead < 128
}

/// In millimetres.
fn distance(scene: &Scene<'_>, [x, y]: [f32; 2]) -> i32 {
    length([x - scene.pose.x, y - scene.pose.y].map(millimetres))
}

/// As many as there is room for.
fn centimetres(mm: i32) -> u16 {
    u16::try_from(mm / 10).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests;
