//! Pictures of a world, drawn in software.
//!
//! Three stages with a seam between each: a scene lists what stands before a lens (gathered from
//! the world), `paint` turns it into colours, depths and names, and a [`Frame`] holds the result
//! and the memory of the other two. Every pixel is the exact intersection of its ray with the
//! shapes, in an order that depends on nothing but the scene; mathematics beyond square roots is
//! `libm`'s. So the same world gives the same bytes everywhere.
//!
//! Textures, colours, light and the imperfections of the camera come from the world's
//! [`Look`](crate::world::Look): the nominal one gives plain paint, one light, no blur and no noise.
//! Distortion bends the rays themselves, so the truth about a picture ([`Frame::spots`],
//! [`Frame::truths`]) is exact under every look; blur, exposure and noise change colours alone.

mod census;
mod coat;
mod decor;
mod frame;
mod noise;
mod paint;
mod rays;
mod scene;
mod sensor;
mod shape;
#[cfg(test)]
mod tests;
mod things;
mod view;

pub use census::Truth;
pub use decor::{Decor, Floor, Wall};
pub use frame::{FRAME_SIDE, Frame, FrameSizeError, Seen, Spot};
pub use sensor::Motion;

use scene::Scene;
pub(crate) use view::{picture_key, view, view_moving};
#[cfg(test)]
use {
    coat::Coat,
    paint::paint,
    scene::Lens,
    shape::{Form, Shape},
};
