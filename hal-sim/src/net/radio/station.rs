//! One robot's radio: where it is, whom it hears, and what that is worth.

use rand_pcg::Pcg32;

use super::airtime::Flow;
use super::survey::{Quality, Survey};
use crate::net::lockstep::Cut;
use crate::world::{Purpose, normal, stream};

/// Which way something goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    /// From the robot.
    Up,
    /// To the robot.
    Down,
}

/// Whether anything gets through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Reach {
    /// It does.
    #[default]
    Up,
    /// Nothing does, and the robot is not told.
    Silent,
    /// Nothing does, and the robot knows that it has no access point.
    Lost,
}

impl Reach {
    /// What is wrong with a link of which the radio makes this, and to which `cut` was done.
    pub(crate) const fn and(self, cut: Cut) -> Cut {
        match (cut, self) {
            (Cut::None | Cut::Silent, Self::Lost) => Cut::Radio,
            (Cut::None, Self::Silent) => Cut::Silent,
            (cut, _) => cut,
        }
    }
}

/// How much of the fading of one look is left in the next: half of it changes in a third of a
/// second.
const KEPT: f32 = 0.8;
/// √(1 − KEPT²): what is drawn anew, so that the deviation stays the same.
const NEW: f32 = 0.6;
/// How much more than the weakest usable signal it takes to join, decibels: without it a robot
/// at the edge would come and go.
const JOIN_MARGIN_DB: f32 = 3.0;
/// Looks from one scan for better access points to the next.
const SCAN_EVERY: u64 = 10;

/// What a station is to its access point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bond {
    /// Nothing, and it looks for one.
    Searching,
    /// Nothing, and a partition keeps it from joining one.
    Banned,
    /// It is about to become a member.
    Joining,
    /// A member.
    Joined,
}

/// See the [module](self).
#[derive(Debug)]
pub(super) struct Station {
    /// Of the robot, among all of its fleet.
    pub(super) number: u32,
    pub(super) place: Option<(f32, f32)>,
    rng: Pcg32,
    /// Access point that it has joined, or had.
    point: u16,
    bond: Bond,
    fading_db: f32,
    pub(super) rssi_dbm: i8,
    /// When it stopped hearing its access point.
    deaf_since_us: Option<u64>,
    /// When joining or changing is over; nothing gets through before.
    busy_until_us: u64,
    pub(super) reach: Reach,
    pub(super) quality: Quality,
    pub(super) up: Flow,
    pub(super) down: Flow,
    /// It is in the list of those that have something to send.
    pub(super) listed: bool,
}

impl Station {
    pub(super) fn new(number: u32, survey: &Survey, seed: u64) -> Self {
        Self {
            number,
            place: None,
            rng: stream(seed, number, Purpose::Radio),
            point: 0,
            bond: Bond::Searching,
            fading_db: 0.0,
            rssi_dbm: -127,
            deaf_since_us: None,
            busy_until_us: 0,
            reach: Reach::Lost,
            quality: survey.quality(0.0, 0.0),
            up: Flow::default(),
            down: Flow::default(),
            listed: false,
        }
    }

    pub(super) fn point(&self) -> usize {
        self.point.into()
    }

    /// Joins what there is, without the time that takes: the world begins in the middle of things.
    pub(super) fn begin(&mut self, survey: &Survey, behind: f32) {
        let (point, level) = survey.best(self.place);
        self.bond = if level >= survey.floor_dbm() {
            Bond::Joined
        } else {
            Bond::Searching
        };
        self.point = point as u16;
        self.settle(survey, behind, level, 0);
    }

    /// Looks around. `tick` counts looks.
    pub(super) fn look(&mut self, survey: &Survey, behind: f32, now_us: u64, tick: u64) {
        let figures = &survey.figures;
        if figures.fading_db > 0.0 {
            let new = NEW * figures.fading_db * normal(&mut self.rng);
            self.fading_db = KEPT * self.fading_db + new;
        }
        let scans = (tick + u64::from(self.number)).is_multiple_of(SCAN_EVERY);
        let floor = survey.floor_dbm();
        let mut level = survey.level(self.point(), self.place);
        let wants = match self.bond {
            Bond::Searching => true,
            Bond::Banned => false,
            Bond::Joining | Bond::Joined => survey.points() > 1,
        };
        if scans && wants {
            let (best, strength) = survey.best(self.place);
            let (needs, takes, bond) = if self.bond == Bond::Searching {
                (floor + JOIN_MARGIN_DB, figures.joining_ms, Bond::Joining)
            } else {
                (level + figures.hysteresis_db, figures.roaming_ms, self.bond)
            };
            if strength >= needs && (best != self.point() || self.bond == Bond::Searching) {
                self.busy_until_us = now_us + (takes * 1_000.0) as u64;
                self.bond = bond;
                self.point = best as u16;
                self.deaf_since_us = None;
                level = strength;
            }
        }
        self.settle(survey, behind, level, now_us);
    }

    fn settle(&mut self, survey: &Survey, behind: f32, level: f32, now_us: u64) {
        let heard = level + self.fading_db;
        let cut = self.partition(survey, now_us);
        if heard >= survey.floor_dbm() {
            self.deaf_since_us = None;
        } else if matches!(self.bond, Bond::Joining | Bond::Joined) {
            let since = *self.deaf_since_us.get_or_insert(now_us);
            let patience = (survey.figures.lost_after_ms * 1_000.0) as u64;
            if now_us - since >= patience {
                self.bond = Bond::Searching;
            }
        }
        let busy = now_us < self.busy_until_us;
        self.bond = match self.bond {
            _ if cut == Reach::Lost => Bond::Banned,
            Bond::Banned => Bond::Searching,
            Bond::Joining if !busy => Bond::Joined,
            bond => bond,
        };
        self.reach = match self.bond {
            Bond::Searching | Bond::Banned | Bond::Joining => Reach::Lost,
            Bond::Joined if busy || self.deaf_since_us.is_some() => Reach::Silent,
            Bond::Joined => cut,
        };
        if self.reach == Reach::Lost {
            self.deaf_since_us = None;
            self.up.clear();
            self.down.clear();
        } else {
            self.rssi_dbm = libm::roundf(heard.clamp(-126.0, 0.0)) as i8;
        }
        if self.reach == Reach::Up {
            self.quality = survey.quality(heard, behind);
        }
    }

    /// What the partitions of the moment leave.
    fn partition(&self, survey: &Survey, now_us: u64) -> Reach {
        let now_s = now_us as f64 * 1e-6;
        let mut reach = Reach::Up;
        for (index, partition) in survey.radio.partitions.iter().enumerate() {
            let holds = (partition.from_s..partition.until_s).contains(&now_s)
                && partition
                    .access_point
                    .is_none_or(|point| usize::from(point) == self.point())
                && partition
                    .region
                    .is_none_or(|region| self.place.is_some_and(|place| region.contains(place)))
                && survey.is_drawn(index, self.number);
            if holds && partition.known {
                return Reach::Lost;
            }
            if holds {
                reach = Reach::Silent;
            }
        }
        reach
    }

    pub(super) fn flow(&mut self, direction: Direction) -> &mut Flow {
        match direction {
            Direction::Up => &mut self.up,
            Direction::Down => &mut self.down,
        }
    }
}
