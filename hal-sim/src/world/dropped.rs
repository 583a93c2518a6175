//! What is put into a world while it runs, and taken away again.
//!
//! It stands at the end of the arena's own lists, so that robots meet it, rangers hear it and
//! cameras see it as they do everything else there.

pub use crawler_sim_protocol::Dropped;
use serde::{Deserialize, Serialize};

use super::RobotIndex;
use super::arena::{MAX_OBSTACLES, Obstacle, Solid};
use super::bodies::Presence;
use super::fingerprint::StateFingerprint;
use super::physics::SKIN_M;
use super::space::{Space, fits_grid};

/// Most dropped things that one world holds at a time.
pub const MAX_DROPPED: usize = 256;

/// Least extent of a dropped thing, metres.
const LEAST_M: f32 = 0.01;

/// What lies in a world because it was dropped there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DroppedItem {
    /// Its number: from 1, and given once in the life of a world.
    pub id: u32,
    /// What it is.
    #[serde(flatten)]
    pub what: Dropped,
}

/// Why something cannot be dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DropError {
    /// A number of it is not finite, or a length shorter than a centimetre.
    Numbers,
    /// It does not lie within the walls as a whole.
    Outside,
    /// This robot stands there.
    OnRobot(RobotIndex),
    /// [`MAX_DROPPED`] things lie in the world, or it has all obstacles that it can have.
    TooMany,
}

impl core::fmt::Display for DropError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Numbers => f.write_str("it must have finite numbers and be 1 cm wide at least"),
            Self::Outside => f.write_str("it does not lie within the walls"),
            Self::OnRobot(robot) => write!(f, "robot number {} stands there", robot.get() + 1),
            Self::TooMany => write!(f, "no more than {MAX_DROPPED} things can lie in a world"),
        }
    }
}

impl core::error::Error for DropError {}

/// Everything dropped that lies in a world.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Items {
    /// In the order in which they came.
    all: Vec<DroppedItem>,
    /// How many were ever dropped.
    given: u32,
}

impl Items {
    pub(crate) fn all(&self) -> &[DroppedItem] {
        &self.all
    }

    pub(crate) fn fold(&self, print: &mut StateFingerprint) {
        for item in &self.all {
            print.word(u64::from(item.id));
            let numbers = match item.what {
                Dropped::Obstacle(Obstacle::Circle { x, y, r }) => [x, y, r, 0.0, 0.0],
                Dropped::Obstacle(Obstacle::Box { x, y, w, h, theta }) => [x, y, w, h, theta],
                Dropped::Object(object) => {
                    print.word((object.shape as u64) << 8 | object.colour as u64);
                    [object.x, object.y, object.size, 0.0, 0.0]
                }
            };
            for number in numbers {
                print.word(u64::from(number.to_bits()));
            }
        }
    }
}

/// Checks that the numbers of `what` are such.
///
/// # Errors
/// [`DropError::Numbers`].
pub(crate) fn validate_dropped(what: &Dropped) -> Result<(), DropError> {
    // An infinity is longer than any arena, and refused for that.
    let length = |length: f32| length.is_finite() && length >= LEAST_M;
    let sound = match what.body() {
        Obstacle::Circle { x, y, r } => x.is_finite() && y.is_finite() && length(2.0 * r),
        Obstacle::Box { x, y, w, h, theta } => {
            x.is_finite() && y.is_finite() && theta.is_finite() && length(w) && length(h)
        }
    };
    if sound {
        Ok(())
    } else {
        Err(DropError::Numbers)
    }
}

impl Space {
    /// Puts something into the arena; returns its number.
    ///
    /// # Errors
    /// See [`DropError`]; nothing has changed then.
    pub(crate) fn drop_in(&mut self, what: Dropped) -> Result<u32, DropError> {
        validate_dropped(&what)?;
        let solid = Solid::new(&what.body());
        let (centre, half) = (solid.centre(), solid.half_extents());
        // What stands at a wall may be off by a rounding.
        let within = centre.x.abs() + half.x <= self.arena.width * 0.5 + SKIN_M
            && centre.y.abs() + half.y <= self.arena.height * 0.5 + SKIN_M;
        if !within {
            return Err(DropError::Outside);
        }
        let standing = self.arena.obstacles.len() + self.arena.objects.len();
        let all = self.solids.iter().copied().chain([solid]);
        if self.items.all.len() >= MAX_DROPPED
            || standing >= MAX_OBSTACLES
            || self.items.given == u32::MAX
            || !fits_grid(&self.cells, all)
        {
            return Err(DropError::TooMany);
        }
        let reach = self.parameters.chassis.radius_m + SKIN_M;
        let seen = &self.bodies.published;
        let under = (0..self.bodies.len()).find(|&i| {
            seen.presence[i] != Presence::Removed && solid.separation(seen.at[i]).0 < reach
        });
        if let Some(robot) = under {
            return Err(DropError::OnRobot(RobotIndex::new(robot as u32)));
        }
        self.items.given += 1;
        let id = self.items.given;
        self.items.all.push(DroppedItem { id, what });
        self.list_in_arena(what);
        self.rebuild_solids();
        Ok(id)
    }

    fn list_in_arena(&mut self, what: Dropped) {
        match what {
            Dropped::Obstacle(obstacle) => self.arena.obstacles.push(obstacle),
            Dropped::Object(object) => self.arena.objects.push(object),
        }
    }

    /// Takes away what was dropped as number `id`; false when nothing of that number lies there.
    pub(crate) fn take_away(&mut self, id: u32) -> bool {
        let Some(place) = self.items.all.iter().position(|item| item.id == id) else {
            return false;
        };
        self.without_items();
        self.items.all.remove(place);
        for item in self.items.all.clone() {
            self.list_in_arena(item.what);
        }
        self.rebuild_solids();
        true
    }

    /// Takes all that was dropped out of the arena's lists.
    fn without_items(&mut self) {
        let objects = self.items.all.iter();
        let objects = objects.filter(|item| matches!(item.what, Dropped::Object(_)));
        let objects = objects.count();
        let obstacles = self.items.all.len() - objects;
        let (standing, lying) = (&mut self.arena.obstacles, &mut self.arena.objects);
        standing.truncate(standing.len() - obstacles);
        lying.truncate(lying.len() - objects);
    }

    /// Has these things lie in the arena and no others: they lay in one like it.
    #[cfg(feature = "live")]
    pub(crate) fn lay_out(&mut self, items: Items) {
        self.without_items();
        self.items = items;
        for item in self.items.all.clone() {
            self.list_in_arena(item.what);
        }
        self.rebuild_solids();
    }
}
