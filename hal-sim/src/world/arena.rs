//! The room: a walled rectangle and what is in it.

mod contents;
mod solid;

use serde::{Deserialize, Serialize};

use super::geometry::Pose;
pub use contents::{Mover, Patch};
pub use crawler_sim_protocol::{Colour, Object, ObjectShape, Obstacle};
pub(crate) use solid::Solid;

/// Shortest and longest side of an arena, in metres.
///
/// At 500 m a 32-bit coordinate still resolves 0.03 mm, a third of the collision skin.
pub const ARENA_SIDE_M: core::ops::RangeInclusive<f32> = 0.5..=500.0;

/// Most obstacles one arena may hold.
pub const MAX_OBSTACLES: usize = 50_000;

/// Most movers one arena may hold.
pub const MAX_MOVERS: usize = 256;

/// Most patches one arena may hold.
pub const MAX_PATCHES: usize = 4_096;

/// A walled rectangle centred on the origin, with obstacles.
///
/// The serialised form is what a scenario file holds and what the live feed announces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arena {
    /// Length along x, in metres; walls stand at ±width/2.
    pub width: f32,
    /// Length along y, in metres; walls stand at ±height/2.
    pub height: f32,
    /// What stands in it.
    #[serde(default)]
    pub obstacles: Vec<Obstacle>,
    /// What moves in it by itself.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub movers: Vec<Mover>,
    /// Parts of the floor that grip differently.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub patches: Vec<Patch>,
    /// Colour of obstacles and movers; bare where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paint: Option<Colour>,
    /// Coloured things to see. As solid as obstacles.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<Object>,
}

/// Why an arena cannot be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ArenaError {
    /// A side is not a number within [`ARENA_SIDE_M`].
    Side,
    /// More than [`MAX_OBSTACLES`], objects included.
    TooManyObstacles,
    /// More than [`MAX_MOVERS`].
    TooManyMovers,
    /// More than [`MAX_PATCHES`].
    TooManyPatches,
    /// This obstacle has a coordinate that is not finite, an extent that is not positive, or is
    /// larger than the arena or centred outside of it.
    Obstacle(usize),
    /// The same about this object.
    Object(usize),
    /// The same about this patch, or its grip is out of range.
    Patch(usize),
    /// The same about the body of this mover, or its path leaves the arena, is too long or goes
    /// nowhere, or its speed is out of range.
    Mover(usize),
}

const SOUND: &str = "must have finite coordinates and positive extents and fit the arena";

impl core::fmt::Display for ArenaError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Side => write!(
                f,
                "a side of the arena must be {} m to {} m",
                ARENA_SIDE_M.start(),
                ARENA_SIDE_M.end()
            ),
            Self::TooManyObstacles => write!(f, "more than {MAX_OBSTACLES} obstacles"),
            Self::TooManyMovers => write!(f, "more than {MAX_MOVERS} movers"),
            Self::TooManyPatches => write!(f, "more than {MAX_PATCHES} patches"),
            Self::Obstacle(index) => write!(f, "obstacle {index} {SOUND}"),
            Self::Object(index) => write!(f, "object {index} {SOUND}"),
            Self::Patch(index) => write!(
                f,
                "patch {index} {SOUND}, with a grip of {} to {}",
                Patch::GRIP.start(),
                Patch::GRIP.end()
            ),
            Self::Mover(index) => write!(
                f,
                "mover {index} {SOUND}, all along a path of 1 to {} corners, at a speed above 0 \
                 and up to {} m/s",
                Mover::MAX_CORNERS,
                Mover::MAX_SPEED
            ),
        }
    }
}

impl core::error::Error for ArenaError {}

impl Arena {
    /// An empty arena of `width` × `height` metres.
    pub const fn empty(width: f32, height: f32) -> Self {
        Self {
            width,
            height,
            obstacles: Vec::new(),
            movers: Vec::new(),
            patches: Vec::new(),
            paint: None,
            objects: Vec::new(),
        }
    }

    /// Checks that a world can be built of it.
    ///
    /// # Errors
    /// The first thing found wrong, see [`ArenaError`].
    pub fn validate(&self) -> Result<(), ArenaError> {
        if !ARENA_SIDE_M.contains(&self.width) || !ARENA_SIDE_M.contains(&self.height) {
            return Err(ArenaError::Side);
        }
        if self.obstacles.len() + self.objects.len() > MAX_OBSTACLES {
            return Err(ArenaError::TooManyObstacles);
        }
        if self.movers.len() > MAX_MOVERS {
            return Err(ArenaError::TooManyMovers);
        }
        if self.patches.len() > MAX_PATCHES {
            return Err(ArenaError::TooManyPatches);
        }
        let place = |wrong: Option<usize>, error: fn(usize) -> ArenaError| {
            wrong.map_or(Ok(()), |index| Err(error(index)))
        };
        let wrong = self.obstacles.iter().position(|one| !self.fits(one));
        place(wrong, ArenaError::Obstacle)?;
        let wrong = self.objects.iter().position(|one| !self.fits(&one.body()));
        place(wrong, ArenaError::Object)?;
        let wrong = self
            .patches
            .iter()
            .position(|patch| !(self.fits(&patch.ground()) && Patch::GRIP.contains(&patch.grip)));
        place(wrong, ArenaError::Patch)?;
        let wrong = self.movers.iter().position(|one| !one.is_sound(self));
        place(wrong, ArenaError::Mover)
    }

    /// Whether a thing has sound numbers and is centred within the arena.
    fn fits(&self, obstacle: &Obstacle) -> bool {
        let longest = self.width.max(self.height);
        let extent = |length: f32| length > 0.0 && length <= longest;
        let (x, y, sound) = match *obstacle {
            Obstacle::Circle { x, y, r } => (x, y, extent(r)),
            Obstacle::Box { x, y, w, h, theta } => {
                (x, y, extent(w) && extent(h) && theta.is_finite())
            }
        };
        // Not-a-number fails both comparisons.
        sound && self.holds(x, y)
    }

    fn holds(&self, x: f32, y: f32) -> bool {
        x.abs() <= self.width * 0.5 && y.abs() <= self.height * 0.5
    }

    /// Everything solid that never moves: obstacles, then objects.
    pub(crate) fn solids(&self) -> impl Iterator<Item = Solid> {
        let objects = self.objects.iter().map(Object::body);
        self.obstacles
            .iter()
            .copied()
            .chain(objects)
            .map(|obstacle| Solid::new(&obstacle))
    }

    /// Distance in metres from a point to the nearest wall, obstacle, object or mover (where it
    /// starts); negative within one.
    ///
    /// Looks at everything: meant for placing things, not for every step.
    pub fn clearance(&self, x: f32, y: f32) -> f32 {
        let point = Pose::new(x, y, 0.0).position();
        let walls = (self.width * 0.5 - x.abs()).min(self.height * 0.5 - y.abs());
        let movers = self.movers.iter().map(|mover| Solid::new(&mover.body));
        self.solids().chain(movers).fold(walls, |nearest, solid| {
            nearest.min(solid.separation(point).0)
        })
    }
}
