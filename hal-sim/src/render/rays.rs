//! Which way a lens looks through each pixel, and which pixels a thing may show in.

use super::scene::Lens;
use super::shape::{NEAR_M, Shape, Vec3};
use crate::world::Vec2;

/// Pixels of a grid, ends excluded; the grid of a picture begins at 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) columns: (i32, i32),
    pub(super) rows: (i32, i32),
}

/// A lens before a grid of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Optics {
    width: f32,
    height: f32,
    /// Focal length in pixels.
    pub(super) focal: f32,
    /// Cosine and sine of the pitch.
    pitch: Vec2,
    eye_m: f32,
    distortion: f32,
}

impl Optics {
    pub(super) fn new(lens: &Lens, width: u16, height: u16) -> Self {
        Self {
            width: f32::from(width),
            height: f32::from(height),
            focal: f32::from(width) * 0.5 / libm::tanf(lens.half_view),
            pitch: Vec2::unit(lens.pitch),
            eye_m: lens.height,
            distortion: lens.distortion,
        }
    }

    /// The ray through the middle of a pixel: its multiples count metres along the optical axis.
    pub(super) fn ray(&self, column: i32, row: i32) -> Vec3 {
        let right = (column as f32 + 0.5 - self.width * 0.5) / self.focal;
        let up = (self.height * 0.5 - row as f32 - 0.5) / self.focal;
        let bent = 1.0 + self.distortion * (right * right + up * up);
        let (right, up) = (right * bent, up * bent);
        Vec3::new(
            self.pitch.x + up * self.pitch.y,
            -right,
            up * self.pitch.x - self.pitch.y,
        )
    }

    /// Where, as a share of its distance from the middle, a point shows that a straight lens
    /// would show at `straight` focal lengths.
    fn drawn_in(&self, straight: f32) -> f32 {
        if self.distortion == 0.0 || straight == 0.0 {
            return 1.0;
        }
        // Newton's method; it comes from above, where the cubic is convex.
        let mut at = straight;
        for _ in 0..6 {
            let square = self.distortion * at * at;
            at -= (at * (1.0 + square) - straight) / (1.0 + 3.0 * square);
        }
        at / straight
    }

    /// The pixels in which something may show that stands at `at`, reaches so far to all sides
    /// and is so high, in a picture with `margin` more pixels on every side; `None` when it shows
    /// in none.
    pub(super) fn window(&self, at: Vec2, reach: Vec2, height: f32, margin: i32) -> Option<Window> {
        let mut low = Vec2::new(f32::INFINITY, f32::INFINITY);
        let mut high = Vec2::new(f32::NEG_INFINITY, f32::NEG_INFINITY);
        let mut behind = 0;
        for corner in 0..8_u8 {
            let sign = |bit: u8| if corner & bit == 0 { -1.0 } else { 1.0 };
            let x = at.x + sign(1) * reach.x;
            let y = at.y + sign(2) * reach.y;
            let z = if corner & 4 == 0 { 0.0 } else { height } - self.eye_m;
            let ahead = x * self.pitch.x - z * self.pitch.y;
            if ahead <= NEAR_M {
                behind += 1;
                continue;
            }
            let right = -y / ahead;
            let down = -(x * self.pitch.y + z * self.pitch.x) / ahead;
            low = Vec2::new(low.x.min(right), low.y.min(down));
            high = Vec2::new(high.x.max(right), high.y.max(down));
        }
        let all = Window {
            columns: (-margin, self.width as i32 + margin),
            rows: (-margin, self.height as i32 + margin),
        };
        match behind {
            8 => return None,
            0 => {}
            // It reaches past the lens: it may show anywhere.
            _ => return Some(all),
        }
        // Distortion moves every point inwards, the furthest most.
        let furthest = Vec2::new(low.x.abs().max(high.x.abs()), low.y.abs().max(high.y.abs()));
        let shrunk = self.drawn_in(furthest.length());
        let span = |low: f32, high: f32, size: f32, most: (i32, i32)| {
            let low = low.min(low * shrunk) * self.focal + size * 0.5;
            let high = high.max(high * shrunk) * self.focal + size * 0.5;
            // Casts saturate, so what lies outside ends up at an edge.
            let first = (libm::floorf(low - 1.0) as i32).max(most.0);
            let last = ((high + 2.0) as i32).min(most.1);
            (first < last).then_some((first, last))
        };
        Some(Window {
            columns: span(low.x, high.x, self.width, all.columns)?,
            rows: span(low.y, high.y, self.height, all.rows)?,
        })
    }

    /// The same for a shape.
    pub(super) fn window_of(&self, shape: &Shape, margin: i32) -> Option<Window> {
        let (reach, height) = shape.form.extents();
        self.window(shape.at, reach, height, margin)
    }
}

/// The rays of all pixels, kept from picture to picture.
#[derive(Debug, Clone, Default)]
pub(super) struct Rays {
    of: Optics,
    rays: Vec<Vec3>,
}

impl Rays {
    /// The rays of a picture, row by row from the top left.
    pub(super) fn of(&mut self, optics: &Optics) -> &[Vec3] {
        if self.of != *optics || self.rays.is_empty() {
            self.of = *optics;
            self.rays.clear();
            let (columns, rows) = (optics.width as i32, optics.height as i32);
            for row in 0..rows {
                self.rays
                    .extend((0..columns).map(|column| optics.ray(column, row)));
            }
        }
        &self.rays
    }
}
