//! What stands before a lens.

use super::decor::Decor;
use super::shape::Shape;
use crate::world::{Colour, Look, Pose, Vec2};

/// A lens: where it is, where it looks, and how wide.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Lens {
    /// Above the ground, and the heading; metres and radians.
    pub(crate) pose: Pose,
    /// Height above the floor, metres.
    pub(crate) height: f32,
    /// How far it looks down, radians.
    pub(crate) pitch: f32,
    /// Half the horizontal field of view, radians.
    pub(crate) half_view: f32,
    /// Barrel distortion, see [`crate::world::Look`].
    pub(crate) distortion: f32,
}

impl Lens {
    /// Half the angle, seen from above, that a picture of these proportions covers, radians.
    ///
    /// A lens that looks down or up sees further to the sides in the corners. Stays below a
    /// quarter turn.
    pub(crate) fn half_sweep(&self, height_to_width: f32) -> f32 {
        /// A sound cone and a view have to be narrower than half a turn.
        const WIDEST: f32 = 1.5;
        let side = libm::tanf(self.half_view);
        let corner = side * side * (1.0 + height_to_width * height_to_width);
        let side = side * (1.0 + self.distortion * corner);
        let ahead =
            libm::cosf(self.pitch) - side * height_to_width * libm::fabsf(libm::sinf(self.pitch));
        if ahead <= 0.0 {
            return WIDEST;
        }
        libm::atan2f(side, ahead).min(WIDEST)
    }
}

/// Everything a picture is made of. Shapes are in the frame of the lens: x ahead of it, y to its
/// left, z above the floor.
#[derive(Debug, Clone, Default)]
pub(crate) struct Scene {
    pub(crate) lens: Lens,
    /// Half the sides of the arena, metres.
    pub(crate) half: Vec2,
    pub(super) decor: Decor,
    pub(super) look: Look,
    /// Colour of obstacles.
    pub(super) paint: Option<Colour>,
    pub(crate) shapes: Vec<Shape>,
    /// Keys of what was listed already, while the world gathers.
    pub(crate) listed: Vec<u64>,
}

impl Scene {
    /// Begins anew, keeping the memory, with a perfect camera.
    pub(super) fn set(&mut self, lens: Lens, half: Vec2, decor: Decor) {
        self.lens = lens;
        self.half = half;
        self.decor = decor;
        self.look = Look::default();
        self.paint = None;
        self.shapes.clear();
        self.listed.clear();
    }
}
