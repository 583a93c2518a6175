//! The shapes that robots form.

use super::Places;
use crate::words::words;

words! {
    /// What robots form together.
    Shape {
        /// Triangles all over.
        Lattice = "lattice",
        /// One beside the other.
        Line = "line",
        /// Two arms back from a point, at a right angle to each other.
        Wedge = "wedge",
        /// A ring, evenly spread.
        Circle = "circle",
    }
}

/// A formation: parameters of the behaviour `formation`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Formation {
    /// What it looks like.
    pub shape: Shape,
    /// Metres from neighbour to neighbour; of a circle its radius: `spacing` and `radius` on the wire.
    pub size: f32,
    /// Where it faces, in radians from the x axis, within ±[`MOST_HEADING`](Self::MOST_HEADING): a line stands across that,
    /// and a wedge points there.
    pub heading: f32,
    /// Where its middle goes, one after the other. With one place it stays there.
    pub path: Places,
}

impl Formation {
    /// Least and most metres between neighbours: nearer, robots take each other for something in the way; farther, they
    /// may not hear each other.
    pub const SPACING: [f32; 2] = [0.5, 1.0];
    /// Those where none are given.
    pub const DEFAULT_SPACING: f32 = 0.8;
    /// Least and largest radius of a circle in metres.
    pub const RADIUS: [f32; 2] = [0.5, 8.0];
    /// That where none is given.
    pub const DEFAULT_RADIUS: f32 = 1.5;
    /// Most radians of a heading, either way.
    pub const MOST_HEADING: f32 = 6.3;

    /// The name of `size`, its least and most, and what it is where it is not given.
    #[must_use]
    pub const fn size_of(shape: Shape) -> (&'static str, [f32; 2], f32) {
        match shape {
            Shape::Lattice | Shape::Line | Shape::Wedge => {
                ("spacing", Self::SPACING, Self::DEFAULT_SPACING)
            }
            Shape::Circle => ("radius", Self::RADIUS, Self::DEFAULT_RADIUS),
        }
    }
}
