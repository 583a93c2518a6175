//! What the server knows of each robot, from what robots say.
//!
//! One value behind one lock, changed by messages ([`FleetState::receive`]) and by time passing
//! ([`FleetState::sweep`]). It holds at most [`MAX_ROBOTS`] robots, a bounded number of log records
//! and of events, and a bounded weight of images, whatever arrives.
//!
//! Reading order: `robot` is what is known of one, `presence` whether it is there, `incoming` a message
//! and `ingest` what it changes, `images` the newest pictures, [`maps`] what robots know of their surroundings, `counts` what the metrics tell. `shape`
//! and `fence` are what a fence is, `fences` who is on the wrong side of one, [`enforcement`] what happens
//! then. `events` is what people are told, which [`recorder`] takes to the records, and [`feed`] shows all
//! of it as it changes. [`bus`] is the session with the broker, over which messages come and go.

pub mod bus;
mod counts;
pub mod enforcement;
mod events;
pub mod feed;
mod fence;
mod fences;
mod images;
mod incoming;
mod ingest;
pub mod maps;
mod presence;
pub mod recorder;
mod robot;
mod shape;
#[cfg(test)]
mod shape_tests;
#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crawler_protocol::open::{Response, Telemetry, Unknown};
use crawler_protocol::{Fleet, MapSegment, PoseFix, RobotId};

pub use counts::RobotCounts;
pub use events::{Event, EventLog, Level};
pub use fence::{Fence, FenceAction, FenceKind};
pub use fences::Crossing;
pub use images::Image;
pub use incoming::Incoming;
pub use ingest::Rejection;
pub use presence::Presence;
pub use robot::{Robot, UnknownCount};
pub use shape::{Shape, ShapeError};

/// The live feed numbers robots with 16 bits; this stays below with room for a bad day.
pub const MAX_ROBOTS: usize = 20_000;
/// Log records kept, of all robots together. Each robot has an equal share.
const MAX_LOGS: usize = 100_000;
const LOGS_PER_ROBOT: std::ops::RangeInclusive<usize> = 5..=200;

/// How many robots there are of each presence.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Presences {
    /// [`Presence::Online`].
    pub online: usize,
    /// [`Presence::Stale`].
    pub stale: usize,
    /// [`Presence::Offline`].
    pub offline: usize,
}

/// What a message was, beyond what it changed here.
#[derive(Debug, PartialEq)]
pub enum Received {
    /// Nothing for anybody else.
    Noted,
    /// Samples of a robot.
    Telemetry {
        /// Oldest first, but for the newest.
        earlier: Vec<Telemetry>,
        /// The newest of them, where a message that is newer has come already; else the robot's entry now has it.
        overtaken: Option<Box<Telemetry>>,
    },
    /// An answer to a command.
    Response(Response),
    /// A part of the map of a robot.
    Map(Box<MapSegment>),
    /// Where a tracker saw a robot that is known.
    Fix(Box<PoseFix>),
}

/// All robots of the fleet.
pub struct FleetState {
    fleet: Fleet,
    slots: Vec<Option<Robot>>,
    indices: HashMap<RobotId, u16>,
    /// Robots whose roster line changed since the feed last looked.
    changed: BTreeSet<u16>,
    removed: Vec<u16>,
    /// Changes of presence between two sweeps, not yet told as events.
    moved: Vec<(RobotId, Presence)>,
    /// The newest image of each robot that has sent any.
    images: images::Images,
    rejected: ingest::RejectionLog,
    fences: fences::Fences,
    /// Of how much of the last message nothing was known.
    unknown: Unknown,
    /// Whether other servers tell what they hear, so that messages of one robot come two ways.
    relayed: bool,
    /// What has happened, newest last.
    pub events: EventLog,
}

/// What changed in the roster since it was last asked for.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct RosterChanges {
    /// Indices of robots whose line is another.
    pub changed: BTreeSet<u16>,
    /// Indices of robots that are forgotten.
    pub removed: Vec<u16>,
}

/// The fleet behind its lock. A panic while it was held leaves values that are each still valid.
pub struct SharedFleet(Mutex<FleetState>);

impl SharedFleet {
    /// Without a robot.
    pub fn new(fleet: Fleet) -> Self {
        Self(Mutex::new(FleetState::new(fleet)))
    }

    /// Its state, for a moment: whoever holds it waits for nothing.
    pub fn lock(&self) -> MutexGuard<'_, FleetState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl FleetState {
    /// Without a robot.
    pub fn new(fleet: Fleet) -> Self {
        Self {
            fleet,
            slots: Vec::new(),
            indices: HashMap::new(),
            changed: BTreeSet::new(),
            removed: Vec::new(),
            moved: Vec::new(),
            images: images::Images::default(),
            rejected: ingest::RejectionLog::default(),
            fences: fences::Fences::default(),
            unknown: Unknown::default(),
            relayed: false,
            events: EventLog::default(),
        }
    }

    /// From here on messages of one robot come two ways, and one can overtake another.
    pub fn relayed(&mut self) {
        self.relayed = true;
    }

    /// What is known of a robot.
    pub fn get(&self, id: &RobotId) -> Option<&Robot> {
        let index = *self.indices.get(id)?;
        self.slots.get(usize::from(index))?.as_ref()
    }

    /// Of how much of the message that was accepted last nothing was known.
    pub const fn last_unknown(&self) -> Unknown {
        self.unknown
    }

    /// The newest image of a robot.
    pub fn image(&self, id: &RobotId) -> Option<&Image> {
        self.images.get(id)
    }

    /// Every robot, by index.
    pub fn robots(&self) -> impl Iterator<Item = &Robot> {
        self.slots.iter().flatten()
    }

    /// See [`Presences`].
    pub fn presences(&self) -> Presences {
        let mut presences = Presences::default();
        for robot in self.robots() {
            *match robot.presence {
                Presence::Online => &mut presences.online,
                Presence::Stale => &mut presences.stale,
                Presence::Offline => &mut presences.offline,
            } += 1;
        }
        presences
    }

    /// Takes the roster changes that have piled up.
    pub fn take_roster_changes(&mut self) -> RosterChanges {
        RosterChanges {
            changed: std::mem::take(&mut self.changed),
            removed: std::mem::take(&mut self.removed),
        }
    }

    /// Recomputes every robot's presence, and makes events of what happened since the last time.
    pub fn sweep(&mut self, now: Instant) {
        let mut moves = std::mem::take(&mut self.moved);
        for robot in self.slots.iter_mut().flatten() {
            let presence = robot.presence_at(now);
            if presence != robot.presence {
                robot.presence = presence;
                self.changed.insert(robot.index);
                moves.push((robot.id.clone(), presence));
            }
        }
        self.events.presence_changes(&moves);
        self.tell_crossings();
    }

    /// The robot's entry, made when it is new and there is room.
    fn entry(&mut self, id: &RobotId, now: Instant) -> Option<&mut Robot> {
        let index = match self.indices.get(id) {
            Some(index) => *index,
            None => self.insert(id, now)?,
        };
        self.slots.get_mut(usize::from(index))?.as_mut()
    }

    fn insert(&mut self, id: &RobotId, now: Instant) -> Option<u16> {
        if self.indices.len() >= MAX_ROBOTS {
            // Whoever has been away longest makes room; a fleet that is all there takes nobody in.
            let gone = self
                .robots()
                .filter(|robot| robot.presence == Presence::Offline)
                .min_by_key(|robot| robot.last_seen.unwrap_or(robot.known_since))
                .map(|robot| robot.id.clone())?;
            self.remove(&gone);
        }
        let free = self.slots.iter().position(Option::is_none);
        let index = free.unwrap_or(self.slots.len());
        let number = u16::try_from(index).ok()?;
        let robot = Robot::new(id.clone(), number, now);
        match self.slots.get_mut(index) {
            Some(slot) => *slot = Some(robot),
            None => self.slots.push(Some(robot)),
        }
        self.indices.insert(id.clone(), number);
        self.changed.insert(number);
        Some(number)
    }

    fn remove(&mut self, id: &RobotId) {
        self.images.remove(id);
        if let Some(index) = self.indices.remove(id) {
            if let Some(slot) = self.slots.get_mut(usize::from(index)) {
                *slot = None;
            }
            self.changed.remove(&index);
            // Readers get every removal; the list is emptied ten times a second.
            self.removed.push(index);
        }
    }

    fn logs_per_robot(&self) -> usize {
        (MAX_LOGS / self.indices.len().max(1)).clamp(*LOGS_PER_ROBOT.start(), *LOGS_PER_ROBOT.end())
    }
}
