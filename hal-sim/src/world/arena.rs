//! The room: a walled rectangle with obstacles in it.

use serde::{Deserialize, Serialize};

use super::geometry::{Pose, Vec2};

/// Shortest and longest side of an arena, in metres.
///
/// At 500 m a 32-bit coordinate still resolves 0.03 mm, a third of the collision skin.
pub const ARENA_SIDE_M: core::ops::RangeInclusive<f32> = 0.5..=500.0;

/// Most obstacles one arena may hold.
pub const MAX_OBSTACLES: usize = 50_000;

/// Something solid that does not move. Lengths in metres, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "lowercase", deny_unknown_fields)]
pub enum Obstacle {
    /// A round post.
    Circle {
        /// Centre.
        x: f32,
        /// Centre.
        y: f32,
        /// Radius.
        r: f32,
    },
    /// A box, turned by `theta` about its centre.
    Box {
        /// Centre.
        x: f32,
        /// Centre.
        y: f32,
        /// Full length along its own x axis.
        w: f32,
        /// Full length along its own y axis.
        h: f32,
        /// Anticlockwise turn.
        #[serde(default)]
        theta: f32,
    },
}

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
}

/// Why an arena cannot be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ArenaError {
    /// A side is not a number within [`ARENA_SIDE_M`].
    Side,
    /// More than [`MAX_OBSTACLES`].
    TooManyObstacles,
    /// This obstacle has a coordinate that is not finite, an extent that is not positive, or is
    /// larger than the arena or centred outside of it.
    Obstacle(usize),
}

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
            Self::Obstacle(index) => write!(
                f,
                "obstacle {index} must have finite coordinates and positive extents and fit the arena"
            ),
        }
    }
}

impl core::error::Error for ArenaError {}

/// An obstacle, prepared: the axis of a box is computed once.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Solid {
    Circle {
        centre: Vec2,
        radius: f32,
    },
    Box {
        centre: Vec2,
        axis: Vec2,
        half: Vec2,
    },
}

impl Solid {
    pub(crate) fn new(obstacle: &Obstacle) -> Self {
        match *obstacle {
            Obstacle::Circle { x, y, r } => Self::Circle {
                centre: Vec2::new(x, y),
                radius: r,
            },
            Obstacle::Box { x, y, w, h, theta } => Self::Box {
                centre: Vec2::new(x, y),
                axis: Vec2::unit(theta),
                half: Vec2::new(w * 0.5, h * 0.5),
            },
        }
    }

    pub(crate) const fn centre(&self) -> Vec2 {
        match *self {
            Self::Circle { centre, .. } | Self::Box { centre, .. } => centre,
        }
    }

    /// Half the extents of the axis-parallel box around it.
    pub(crate) fn half_extents(&self) -> Vec2 {
        match *self {
            Self::Circle { radius, .. } => Vec2::new(radius, radius),
            Self::Box { axis, half, .. } => {
                let (c, s) = (axis.x.abs(), axis.y.abs());
                Vec2::new(half.x * c + half.y * s, half.x * s + half.y * c)
            }
        }
    }

    /// Distance from `point` to the surface, negative inside, with the outward direction.
    pub(crate) fn separation(&self, point: Vec2) -> (f32, Vec2) {
        match *self {
            Self::Circle { centre, radius } => {
                let away = point.minus(centre);
                let distance = away.length();
                let direction = if distance > 0.0 {
                    away.times(1.0 / distance)
                } else {
                    Vec2::new(1.0, 0.0)
                };
                (distance - radius, direction)
            }
            Self::Box { centre, axis, half } => {
                let local = point.minus(centre).into_frame(axis);
                let nearest = Vec2::new(
                    local.x.clamp(-half.x, half.x),
                    local.y.clamp(-half.y, half.y),
                );
                let away = local.minus(nearest);
                let distance = away.length();
                if distance > 0.0 {
                    return (distance, away.times(1.0 / distance).out_of_frame(axis));
                }
                let (deep_x, deep_y) = (half.x - local.x.abs(), half.y - local.y.abs());
                let (depth, face) = if deep_x < deep_y {
                    (deep_x, Vec2::new(1.0_f32.copysign(local.x), 0.0))
                } else {
                    (deep_y, Vec2::new(0.0, 1.0_f32.copysign(local.y)))
                };
                (-depth, face.out_of_frame(axis))
            }
        }
    }

    /// The corners of a box, in order around it.
    pub(crate) fn corners(centre: Vec2, axis: Vec2, half: Vec2) -> [Vec2; 4] {
        [
            Vec2::new(half.x, half.y),
            Vec2::new(-half.x, half.y),
            Vec2::new(-half.x, -half.y),
            Vec2::new(half.x, -half.y),
        ]
        .map(|corner| centre.plus(corner.out_of_frame(axis)))
    }
}

impl Arena {
    /// An empty arena of `width` × `height` metres.
    pub const fn empty(width: f32, height: f32) -> Self {
        Self {
            width,
            height,
            obstacles: Vec::new(),
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
        if self.obstacles.len() > MAX_OBSTACLES {
            return Err(ArenaError::TooManyObstacles);
        }
        let longest = self.width.max(self.height);
        let extent = |length: f32| length > 0.0 && length <= longest;
        for (index, obstacle) in self.obstacles.iter().enumerate() {
            let (x, y, sound) = match *obstacle {
                Obstacle::Circle { x, y, r } => (x, y, extent(r)),
                Obstacle::Box { x, y, w, h, theta } => {
                    (x, y, extent(w) && extent(h) && theta.is_finite())
                }
            };
            // Not-a-number fails both comparisons.
            let inside = x.abs() <= self.width * 0.5 && y.abs() <= self.height * 0.5;
            if !sound || !inside {
                return Err(ArenaError::Obstacle(index));
            }
        }
        Ok(())
    }

    /// Distance in metres from a point to the nearest wall or obstacle; negative within one.
    ///
    /// Looks at every obstacle: meant for placing things, not for every step.
    pub fn clearance(&self, x: f32, y: f32) -> f32 {
        let point = Pose::new(x, y, 0.0).position();
        let walls = (self.width * 0.5 - x.abs()).min(self.height * 0.5 - y.abs());
        self.obstacles.iter().fold(walls, |nearest, obstacle| {
            nearest.min(Solid::new(obstacle).separation(point).0)
        })
    }
}
