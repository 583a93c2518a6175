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

use crate::tracking::{AHEAD, FARTHEST};

/// Most neighbours that are kept: what happens behind the sixteen nearest matters to nobody.
pub const MOST: usize = 16;
/// Age from which a neighbour is forgotten: three messages at two a second.
pub const FRESH_FOR: Duration = Duration::from_millis(1_500);
/// How far outside its cell a robot may be before it is in the next one, in metres.
const MARGIN: f32 = 0.25;
/// Cells that a robot listens to.
pub const CELLS: usize = 9;
/// Fastest a neighbour is taken to be, in metres and radians per second.
const FASTEST: f32 = 5.0;

/// Column and row of a cell.
pub type Cell = (i16, i16);

/// Where another robot is, in the coordinates of position references.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Neighbour {
    /// Stands for its id where only sameness counts: see [`name_of`].
    pub who: u32,
    /// Metres along the x axis.
    pub x: f32,
    /// Metres along the y axis.
    pub y: f32,
    /// Its velocity along both axes, in metres per second.
    pub velocity: [f32; 2],
    /// How fast it turns, in radians per second.
    pub turn: f32,
    /// What it says.
    pub says: Option<Says>,
}

impl Neighbour {
    /// Where it should be `age` seconds later.
    #[must_use]
    pub(crate) fn after(self, age: f32) -> Self {
        let [vx, vy] = self.velocity;
        // To first order: in half a second at the rates at which a flock turns that is off by a fiftieth.
        let turned = (self.turn * age).clamp(-1.0, 1.0);
        Self {
            x: self.x + vx * age,
            y: self.y + vy * age,
            velocity: [vx - vy * turned, vy + vx * turned],
            ..self
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    cell: Cell,
    at: Instant,
    is: Neighbour,
}

/// Neighbours as control sees them.
pub type Near = Vec<Neighbour, MOST>;

/// The hand-over of neighbours from link to control: 1.1 KB.
pub(crate) struct Neighbours<M: RawMutex> {
    seen: Mutex<M, RefCell<Vec<Seen, MOST>>>,
}

impl<M: RawMutex> Neighbours<M> {
    pub(crate) const fn new() -> Self {
        Self {
            seen: Mutex::new(RefCell::new(Vec::new())),
        }
    }

    /// Where the neighbours should be at `now`.
    pub(crate) fn at(&self, now: Instant) -> Near {
        self.seen.lock(|seen| {
            let seen = seen.borrow();
            let fresh = seen.iter().filter(|known| now - known.at <= FRESH_FOR);
            fresh
                .map(|known| known.is.after((now - known.at).as_secs_f32()))
                .collect()
        })
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
        let at = Instant::from_micros(now.as_micros().saturating_sub(age * 1_000));
        let own = name_of(own);
        self.seen.lock(|seen| {
            let seen = &mut *seen.borrow_mut();
            if seen.iter().any(|known| known.cell == cell && known.at > at) {
                return false;
            }
            // Those of a full cell take turns: who is not named now may still be there.
            let all = usize::from(digest.count) <= digest.robots.len();
            seen.retain(|known| (known.cell != cell || !all) && now - known.at <= FRESH_FOR);
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
                let is = Neighbour {
                    who,
                    x: robot.x,
                    y: robot.y,
                    velocity: [
                        robot.v * libm::cosf(robot.theta),
                        robot.v * libm::sinf(robot.theta),
                    ],
                    turn: robot.w,
                    says: robot.says,
                };
                keep(seen, Seen { cell, at, is }, here);
            }
            true
        })
    }
}

/// Puts `new` among the known unless a newer word of the same robot is there, or only nearer ones
/// than there is room for.
fn keep(seen: &mut Vec<Seen, MOST>, new: Seen, here: &Pose) {
    if let Some(known) = seen.iter_mut().find(|known| known.is.who == new.is.who) {
        if known.at <= new.at {
            *known = new;
        }
        return;
    }
    let Err(new) = seen.push(new) else { return };
    let away = |robot: &Seen| {
        let (dx, dy) = (robot.is.x - here.x, robot.is.y - here.y);
        dx * dx + dy * dy
    };
    let farthest = seen.iter_mut().max_by(|a, b| away(a).total_cmp(&away(b)));
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
        BehaviourName::Disperse
        | BehaviourName::Gather
        | BehaviourName::Flock
        | BehaviourName::Formation
        | BehaviourName::Follow
        | BehaviourName::Patrol
        | BehaviourName::Consensus
        | BehaviourName::Allocate => true,
        BehaviourName::Manual
        | BehaviourName::Wander
        | BehaviourName::Goto
        | BehaviourName::Policy => false,
    }
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
