//! What an arena holds beside obstacles and coloured objects: movers, and patches of floor.

use serde::{Deserialize, Serialize};

use super::{Arena, Obstacle};
use crate::world::geometry::Vec2;

/// An obstacle on rails.
///
/// It goes from its own place (`x`, `y` of its body) to each corner of the path in turn, back to
/// its place, and so on, at a constant speed and without turning. It pushes robots out of its way.
/// Where it cannot, because a wall, an obstacle, another mover or another robot is behind the
/// robot, it waits: nothing is ever squeezed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mover {
    /// What it is, where it starts.
    pub body: Obstacle,
    /// Corners of its path after its own place, metres.
    pub path: Vec<[f32; 2]>,
    /// Metres per second.
    pub speed: f32,
}

impl Mover {
    /// Fastest mover, metres per second: a little faster than a robot.
    pub const MAX_SPEED: f32 = 1.0;
    /// Most corners of a path.
    pub const MAX_CORNERS: usize = 64;

    pub(super) fn is_sound(&self, arena: &Arena) -> bool {
        arena.fits(&self.body)
            && (1..=Self::MAX_CORNERS).contains(&self.path.len())
            && self.path.iter().all(|&[x, y]| arena.holds(x, y))
            && self.speed > 0.0
            && self.speed <= Self::MAX_SPEED
            && self.length() > 1e-3
    }

    fn start(&self) -> Vec2 {
        match self.body {
            Obstacle::Circle { x, y, .. } | Obstacle::Box { x, y, .. } => Vec2::new(x, y),
        }
    }

    /// The legs of the path, each with its length.
    fn legs(&self) -> impl Iterator<Item = (Vec2, Vec2, f32)> {
        let corners = self.path.iter().map(|&[x, y]| Vec2::new(x, y));
        let from = core::iter::once(self.start()).chain(corners.clone());
        let to = corners.chain(core::iter::once(self.start()));
        from.zip(to).map(|(a, b)| (a, b, b.minus(a).length()))
    }

    /// Length of the closed path, metres.
    pub fn length(&self) -> f32 {
        self.legs().map(|(_, _, length)| length).sum()
    }

    /// Where its centre is after so many metres of its path, 0 to [`Self::length`].
    pub fn at(&self, mut way: f32) -> [f32; 2] {
        let mut place = self.start();
        for (a, b, length) in self.legs() {
            if way < length {
                place = a.plus(b.minus(a).times(way / length));
                break;
            }
            way -= length;
        }
        [place.x, place.y]
    }
}

/// A rectangle of floor on which wheels grip differently. Where two lie on each other, the one
/// listed later counts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Centre, metres.
    pub x: f32,
    /// Centre, metres.
    pub y: f32,
    /// Full length along its own x axis.
    pub w: f32,
    /// Full length along its own y axis.
    pub h: f32,
    /// Anticlockwise turn, radians.
    #[serde(default)]
    pub theta: f32,
    /// Friction of the wheels as a share of that on the floor around.
    pub grip: f32,
}

impl Patch {
    /// Smallest and largest grip.
    pub const GRIP: core::ops::RangeInclusive<f32> = 0.05..=2.0;

    /// The ground it covers.
    pub(crate) const fn ground(&self) -> Obstacle {
        Obstacle::Box {
            x: self.x,
            y: self.y,
            w: self.w,
            h: self.h,
            theta: self.theta,
        }
    }
}
