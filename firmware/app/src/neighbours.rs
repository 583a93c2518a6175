//! Who is near, from `{fleet}/cell/{x}/{y}` to control.
//!
//! A robot that moves by others listens to its own cell and the eight around it (see
//! [`around`]). Each message tells all of one cell, so it replaces what was known of that cell, unless there
//! are more than it has room for;
//! a robot that crosses a border is in the newer of two messages. The nearest [`MOST`] are kept,
//! for [`FRESH_FOR`], and moved on by their twist in the meantime. What makes no sense is dropped:
//! a message for another cell than its topic names, a robot where none can be, one from the past or
//! from the future.

use core::cell::RefCell;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, CellDigest, Pose, RobotId, Says};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use heapless::Vec;

use crate::motion::angle::{Angle, ONE_BITS, millimetres};
use crate::tracking::{AHEAD, FARTHEST};

/// Most neighbours that are kept: what happens behind the sixteen nearest matters to nobody.
pub const MOST: usize = 16;
/// Age from which a neighbour is forgotten: three messages at two a second.
pub const FRESH_FOR: Duration = Duration::from_millis(1_500);
/// Within this of a robot that only keeps off others a cell is listened to, in metres; beyond the second it is left.
pub const CLOSE: [f32; 2] = [0.8, 1.0];
/// How far outside its cell a robot may be before it is in the next one, in metres.
const MARGIN: f32 = 0.25;
/// Cells that a robot listens to.
pub const CELLS: usize = 9;
/// Fastest a neighbour is taken to be, in metres per second.
const FASTEST: f32 = 5.0;
/// The same in millimetres per second; in 1/1024 rad/s it is the fastest turn.
const FASTEST_MM_S: i32 = 5_000;

/// Column and row of a cell.
pub type Cell = (i16, i16);

/// Another robot, in the coordinates of position references. All in whole numbers: what is reckoned for sixteen of
/// them in every control step must not need floats.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Neighbour {
    /// Stands for its id where only sameness counts: see [`name_of`].
    pub who: u32,
    /// Where it should be, in millimetres along both axes.
    pub at: [i32; 2],
    /// Where it heads, as a direction in 1/[`ONE`](crate::motion::angle::ONE).
    pub ahead: [i16; 2],
    /// How fast it drives there, in millimetres per second.
    pub speed: i16,
    /// How fast it turns, in 1/1024 rad/s.
    pub turn: i16,
    /// What it says.
    pub says: Option<Says>,
    pub(crate) told: Told,
}

/// How a neighbour was last told of.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Told {
    cell: Cell,
    ahead: [i16; 2],
    seen: Instant,
    at: [i32; 2],
    /// Number of the message.
    message: u32,
}

impl Neighbour {
    /// One at a place in metres, with its heading in radians, its speed in metres and its rate of turning in radians per
    /// second.
    pub fn new([x, y]: [f32; 2], theta: f32, speed: f32, turn: f32) -> Self {
        // At most 1.4 times [`ONE`], when it has been turned on.
        let ahead = Angle::from_radians(theta)
            .direction()
            .map(|along| along as i16);
        let at = [x, y].map(millimetres);
        let bounded = |rate: i32| rate.clamp(-FASTEST_MM_S, FASTEST_MM_S) as i16;
        Self {
            at,
            ahead,
            speed: bounded(millimetres(speed)),
            turn: bounded((turn * 1_024.0) as i32),
            told: Told {
                ahead,
                at,
                ..Told::default()
            },
            ..Self::NOBODY
        }
    }

    /// What stands in a place that is free: too far away for anybody to reckon with.
    pub(crate) const NOBODY: Self = Self {
        who: 0,
        at: [i32::MAX / 2; 2],
        ahead: [0; 2],
        speed: 0,
        turn: 0,
        says: None,
        told: Told {
            cell: (0, 0),
            ahead: [0; 2],
            seen: Instant::BOOT,
            at: [i32::MAX / 2; 2],
            message: 0,
        },
    };

    const fn is_nobody(&self) -> bool {
        self.at[0] == Self::NOBODY.at[0]
    }

    /// Whether what is known of it is still worth something.
    fn is_fresh(&self, now: Instant) -> bool {
        !self.is_nobody() && now - self.told.seen <= FRESH_FOR
    }

    /// The same, seen then.
    #[cfg(test)]
    pub(crate) fn seen(mut self, at: Instant) -> Self {
        self.told.seen = at;
        self
    }

    /// Its velocity in millimetres per second along both axes.
    pub fn velocity(&self) -> [i32; 2] {
        let speed = i32::from(self.speed);
        self.ahead
            .map(|along| (i32::from(along) * speed) >> ONE_BITS)
    }

    /// Moves it on to where it should be at `now`, unless what is known of it is worth nothing any more.
    pub(crate) fn advance(&mut self, now: Instant) -> bool {
        let age = now - self.told.seen;
        if age > FRESH_FOR {
            return false;
        }
        // Of a second 1/1024; exact to a five-thousandth.
        let share = ((((age.as_micros() as u32) >> 4) * 1_074) >> 16) as i32;
        let way = (i32::from(self.speed) * share) >> 10;
        let [x, y] = self.told.ahead.map(i32::from);
        self.at = [
            self.told.at[0] + ((x * way) >> ONE_BITS),
            self.told.at[1] + ((y * way) >> ONE_BITS),
        ];
        // To first order: in half a second at the rates at which a flock turns that is off by a fiftieth.
        let turned = ((i32::from(self.turn) * share) >> 10).clamp(-1_024, 1_024);
        self.ahead = [
            (x - ((y * turned) >> 10)) as i16,
            (y + ((x * turned) >> 10)) as i16,
        ];
        true
    }
}

/// Neighbours as control has them.
#[derive(Debug)]
pub struct Near {
    robots: [Neighbour; MOST],
    /// Number of the last message that all of them are of; `None` before that.
    message: Option<u32>,
    /// Whether anybody may be among them.
    used: bool,
}

impl Default for Near {
    fn default() -> Self {
        Self::new()
    }
}

impl Near {
    /// So many at most are taken over in one look: a message about all of them would otherwise make one step
    /// of control dearer than any other.
    const TAKEN: usize = 4;

    /// Nobody yet.
    pub const fn new() -> Self {
        Self {
            robots: [Neighbour::NOBODY; MOST],
            message: None,
            used: false,
        }
    }

    /// Where they should be, with somebody who is nowhere in places that are free.
    pub const fn as_slice(&self) -> &[Neighbour] {
        if self.used { &self.robots } else { &[] }
    }

    /// Knows of nobody until the next look.
    pub(crate) fn forget(&mut self) {
        if self.used {
            *self = Self::new();
        }
    }

    fn take(&mut self, heard: &Heard) {
        if self.message == Some(heard.message) {
            return;
        }
        self.used = true;
        let mut taken = 0;
        for (known, told) in self.robots.iter_mut().zip(&heard.robots) {
            if known.told.message != told.told.message {
                if taken == Self::TAKEN {
                    return;
                }
                *known = *told;
                taken += 1;
            }
        }
        self.message = Some(heard.message);
    }

    fn advance(&mut self, now: Instant) {
        for known in &mut self.robots {
            if !known.is_nobody() && !known.advance(now) {
                let message = known.told.message;
                *known = Neighbour::NOBODY;
                known.told.message = message;
            }
        }
    }
}

/// All that was told.
struct Heard {
    robots: [Neighbour; MOST],
    /// Rises with every message.
    message: u32,
}

/// The hand-over of neighbours from link to control: 1.3 KB.
pub(crate) struct Neighbours<M: RawMutex> {
    heard: Mutex<M, RefCell<Heard>>,
}

impl<M: RawMutex> Neighbours<M> {
    pub(crate) const fn new() -> Self {
        Self {
            heard: Mutex::new(RefCell::new(Heard {
                robots: [Neighbour::NOBODY; MOST],
                message: 0,
            })),
        }
    }

    /// Brings `near` nearer to what is known, and to where they should be at `now`.
    pub(crate) fn look(&self, near: &mut Near, now: Instant) {
        self.heard.lock(|heard| near.take(&heard.borrow()));
        near.advance(now);
    }

    /// Where everybody should be at `now`, one after the other.
    pub(crate) fn each(&self, now: Instant, mut tell: impl FnMut(&Neighbour)) {
        self.heard.lock(|heard| {
            for known in &heard.borrow().robots {
                let mut known = *known;
                if !known.is_nobody() && known.advance(now) {
                    tell(&known);
                }
            }
        });
    }

    /// Takes in the payload of a message on the topic of `cell`, for the robot `own` that is `here`
    /// at `now`, and by its clock at `unix` ms. Whether it was of use.
    pub(crate) fn observe(
        &self,
        cell: Cell,
        payload: &[u8],
        (own, here): (&RobotId, &Pose),
        unix: Option<u64>,
        now: Instant,
    ) -> bool {
        let Ok(digest) = CellDigest::from_json(payload) else {
            return false;
        };
        let age = match unix {
            None => 0,
            Some(unix) if digest.timestamp > unix.saturating_add(AHEAD.as_millis()) => {
                return false;
            }
            Some(unix) => unix.saturating_sub(digest.timestamp),
        };
        if (digest.x, digest.y) != cell || age > FRESH_FOR.as_millis() {
            return false;
        }
        let seen = Instant::from_micros(now.as_micros().saturating_sub(age * 1_000));
        let own = name_of(own);
        let here = [here.x, here.y].map(millimetres);
        self.heard.lock(|heard| {
            let Heard { robots, message } = &mut *heard.borrow_mut();
            let of_cell = |known: &Neighbour| known.told.cell == cell && known.is_fresh(now);
            let mut before = robots.iter().filter(|known| of_cell(known));
            if before.any(|known| known.told.seen > seen) {
                return false;
            }
            *message = message.wrapping_add(1);
            let free = Neighbour {
                told: Told {
                    message: *message,
                    ..Neighbour::NOBODY.told
                },
                ..Neighbour::NOBODY
            };
            // Those of a full cell take turns: who is not named now may still be there.
            let all = usize::from(digest.count) <= digest.robots.len();
            for known in robots.iter_mut() {
                if !known.is_nobody() && (!known.is_fresh(now) || (all && of_cell(known))) {
                    *known = free;
                }
            }
            for robot in &digest.robots {
                let who = name_of(&robot.id);
                let fits = |value: f32, most: f32| libm::fabsf(value) <= most;
                let sane = fits(robot.x, FARTHEST)
                    && fits(robot.y, FARTHEST)
                    && fits(robot.v, FASTEST)
                    && robot.w.is_finite()
                    && robot.theta.is_finite();
                if who == own || !sane {
                    continue;
                }
                let mut new = Neighbour::new([robot.x, robot.y], robot.theta, robot.v, robot.w);
                new.who = who;
                new.says = robot.says;
                new.told.cell = cell;
                new.told.seen = seen;
                new.told.message = *message;
                keep(robots, new, here);
            }
            true
        })
    }
}

/// Puts `new` among the known unless a newer word of the same robot is there, or only nearer ones
/// than there is room for.
fn keep(all: &mut [Neighbour; MOST], new: Neighbour, here: [i32; 2]) {
    let same = |known: &&mut Neighbour| known.who == new.who && !known.is_nobody();
    if let Some(known) = all.iter_mut().find(same) {
        if known.told.seen <= new.told.seen {
            *known = new;
        }
        return;
    }
    let away = |robot: &Neighbour| {
        let [dx, dy] =
            [0, 1].map(|axis: usize| i64::from(robot.told.at[axis]) - i64::from(here[axis]));
        dx * dx + dy * dy
    };
    if let Some(free) = all.iter_mut().find(|known| known.is_nobody()) {
        *free = new;
        return;
    }
    let farthest = all.iter_mut().max_by_key(|known| away(known));
    if let Some(farthest) = farthest
        && away(farthest) > away(&new)
    {
        *farthest = new;
    }
}

/// Stands for an id where only sameness counts: FNV-1a of 32 bits.
#[must_use]
pub fn name_of(id: &RobotId) -> u32 {
    hash(id.as_str().bytes())
}

/// FNV-1a of 32 bits.
pub(crate) fn hash(bytes: impl Iterator<Item = u8>) -> u32 {
    bytes.fold(0x811c_9dc5, |hash, byte| {
        (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
    })
}

/// Whether whoever behaves so has to know who is near.
pub const fn needed_for(behaviour: BehaviourName) -> bool {
    match behaviour {
        BehaviourName::Wander
        | BehaviourName::Goto
        | BehaviourName::Disperse
        | BehaviourName::Gather
        | BehaviourName::Flock
        | BehaviourName::Formation
        | BehaviourName::Follow
        | BehaviourName::Patrol
        | BehaviourName::Consensus
        | BehaviourName::Allocate
        | BehaviourName::Cover
        | BehaviourName::Policy => true,
        BehaviourName::Manual => false,
    }
}

/// Whether that is only to keep off them, so that those of cells farther than [`CLOSE`] away matter to nobody: a fleet that
/// wanders hears a third of what it would otherwise.
pub const fn only_close(behaviour: BehaviourName) -> bool {
    matches!(behaviour, BehaviourName::Wander)
}

/// How far a cell is from a robot at `x`, `y` metres: 0 where it is in it.
pub fn away_from((column, row): Cell, [x, y]: [f32; 2]) -> f32 {
    let along = |at: f32, cell: i16| {
        let from = f32::from(cell) * CellDigest::EDGE_M;
        (from - at).max(at - from - CellDigest::EDGE_M)
    };
    along(x, column).max(along(y, row)).max(0.0)
}

/// The cell of a robot at `x`, `y` metres that was in `before`: that one as long as the robot is no
/// more than 0.25 m outside, so that one on a border does not change it all the time.
pub fn centre(before: Option<Cell>, x: f32, y: f32) -> Option<Cell> {
    let still = |at: f32, cell: i16| {
        let from = f32::from(cell) * CellDigest::EDGE_M;
        (from - MARGIN..=from + CellDigest::EDGE_M + MARGIN).contains(&at)
    };
    before
        .filter(|(column, row)| still(x, *column) && still(y, *row))
        .or_else(|| cell_at(x, y))
}

/// A cell and the eight around it, nearest first.
pub fn around((column, row): Cell) -> Vec<Cell, CELLS> {
    /// Its own, then across an edge, then across a corner.
    const STEPS: [Cell; CELLS] = [
        (0, 0),
        (1, 0),
        (-1, 0),
        (0, 1),
        (0, -1),
        (1, 1),
        (1, -1),
        (-1, 1),
        (-1, -1),
    ];
    STEPS
        .iter()
        .filter_map(|(dx, dy)| Some((column.checked_add(*dx)?, row.checked_add(*dy)?)))
        .collect()
}

/// The cell at `x`, `y` metres; none beyond [`FARTHEST`].
pub fn cell_at(x: f32, y: f32) -> Option<Cell> {
    let along = |metres: f32| {
        (libm::fabsf(metres) <= FARTHEST).then(|| libm::floorf(metres / CellDigest::EDGE_M) as i16)
    };
    Some((along(x)?, along(y)?))
}

#[cfg(test)]
#[path = "neighbours_tests.rs"]
mod tests;
