//! Behaviours with a memory: what a robot was given to do, how far it is, and what it says about that to
//! those around it.
//!
//! | behaviour | rule | after |
//! |---|---|---|
//! | `follow` | behind the leader, or behind the follower that is nearest to the leader in hops | leader and gradient: Balch and Arkin, "Behavior-based formation control for multirobot teams", IEEE TRA 14(6), 1998 |
//! | `patrol` | from place to place, slower when the next one is near and the last one is far | Pasqualetti, Franchi and Bullo, "On cooperative patrolling: optimal trajectories, complexity analysis, and approximation algorithms", IEEE TRO 28(3), 2012 |
//! | `consensus` | the mean of what is left without the most extreme neighbours | W-MSR: `LeBlanc`, Zhang, Koutsoukos and Sundaram, "Resilient asymptotic consensus in robust networks", IEEE JSAC 31(4), 2013 |
//! | `allocate` | the nearest task of which nobody is nearer, and to it | CBAA: Choi, Brunet and How, "Consensus-based decentralized auctions for robust task allocation", IEEE TRO 25(4), 2009 |
//! | `cover` | to the centroid of what is nearer to it than to anybody else | Lloyd, "Least squares quantization in PCM", IEEE Trans. Information Theory 28(2), 1982; Cortés, Martínez, Karataş and Bullo, "Coverage control for mobile sensing networks", IEEE TRA 20(2), 2004 |
//! | `formation` with a shape | to the free place next to it that is nearest to the middle, which moves along a path as fast as all of them | virtual structure: Lewis and Tan, "High precision formation control of mobile robots using virtual structures", Autonomous Robots 4, 1997 |
//!
//! Each is a value that is stepped with what the robot knows; it does no I/O.

mod allocate;
mod consensus;
mod cover;
mod follow;
mod formation;
mod patrol;
#[cfg(test)]
mod tests;

use crawler_hal::Instant;
use crawler_protocol::{Pose, Says};

use crate::goal::Mission;
use crate::neighbours::Neighbour;
use crate::perception::Reading;

use allocate::Allocate;
use consensus::Consensus;
use cover::Cover;
use follow::Follow;
use formation::Shaped;
use patrol::Patrol;

/// What a mission goes by.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// Where the robot is.
    pub pose: &'a Pose,
    /// Who is near.
    pub near: &'a [Neighbour],
    /// The robot itself, as [`Neighbour::who`].
    pub own: u32,
    /// What it measures.
    pub reading: &'a Reading,
    /// Fastest that it drives towards a place, in m/s.
    pub speed: f32,
    /// The time.
    pub now: Instant,
}

/// What a mission wants next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wish {
    /// To stand.
    Rest,
    /// To move with this velocity along both axes, in 1/1024 of the permitted speed.
    Velocity([i32; 2]),
    /// To go to a place, at this share of the speed.
    Place([f32; 2], f32),
    /// Nothing any more.
    Done,
}

/// What somebody may want to read in the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MissionNews {
    /// Nobody near is the leader, or follows it.
    LeaderLost,
    /// The place of this number, counted from 1, could not be reached in time.
    Skipped(u8),
}

/// The mission that a robot is on, or was on last.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
// There is no heap to put the large one on, and there is one of it.
#[allow(clippy::large_enum_variant)]
pub enum Underway {
    /// None since the start.
    #[default]
    None,
    /// `follow`.
    Follow(Follow),
    /// `patrol`.
    Patrol(Patrol),
    /// `consensus`.
    Consensus(Consensus),
    /// `allocate`.
    Allocate(Allocate),
    /// `cover`.
    Cover(Cover),
    /// `formation` with a shape.
    Shaped(Shaped),
}

impl Underway {
    /// At the beginning of `mission`, for a robot at `pose`.
    #[must_use]
    pub fn begin(mission: &Mission, pose: &Pose) -> Self {
        match *mission {
            Mission::Follow { leader, distance } => Self::Follow(Follow::new(leader, distance)),
            Mission::Patrol { waypoints, laps } => Self::Patrol(Patrol::new(waypoints, laps, pose)),
            Mission::Consensus { measure, f } => Self::Consensus(Consensus::new(measure, f)),
            Mission::Allocate { tasks } => Self::Allocate(Allocate::new(tasks)),
            Mission::Cover { area } => Self::Cover(Cover::new(area)),
            Mission::Shaped(formation) => Self::Shaped(Shaped::new(formation)),
        }
    }

    /// Goes on by one step.
    pub fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        match self {
            Self::None => (Wish::Done, None),
            Self::Follow(follow) => follow.step(scene),
            Self::Patrol(patrol) => patrol.step(scene),
            Self::Consensus(consensus) => consensus.step(scene),
            Self::Allocate(allocate) => allocate.step(scene),
            Self::Cover(cover) => cover.step(scene),
            Self::Shaped(shaped) => shaped.step(scene),
        }
    }

    /// The robot is at the place that it wanted to go to.
    pub fn arrived(&mut self) {
        match self {
            Self::Patrol(patrol) => patrol.arrived(),
            Self::Allocate(allocate) => allocate.arrived(),
            Self::None
            | Self::Follow(_)
            | Self::Consensus(_)
            | Self::Cover(_)
            | Self::Shaped(_) => {}
        }
    }

    /// The place that the robot is on its way to.
    #[must_use]
    pub fn destination(&self) -> Option<[f32; 2]> {
        match self {
            Self::Patrol(patrol) => patrol.destination(),
            Self::Allocate(allocate) => allocate.destination(),
            Self::Cover(cover) => cover.destination(),
            Self::None | Self::Follow(_) | Self::Consensus(_) | Self::Shaped(_) => None,
        }
    }

    /// What neighbours are told.
    #[must_use]
    pub fn says(&self) -> Option<Says> {
        match self {
            Self::None => None,
            Self::Follow(follow) => Some(follow.says()),
            Self::Patrol(patrol) => Some(patrol.says()),
            Self::Consensus(consensus) => consensus.says(),
            Self::Allocate(allocate) => Some(allocate.says()),
            Self::Cover(cover) => Some(cover.says()),
            Self::Shaped(shaped) => Some(shaped.says()),
        }
    }
}
