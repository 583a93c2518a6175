//! Numbers out of places: the same everywhere, without tables and without state.

/// Mixes all bits of a word (Wellons, "Prospecting for Hash Functions", 2018: `lowbias32`).
pub(crate) const fn scramble(word: u32) -> u32 {
    let word = (word ^ (word >> 16)).wrapping_mul(0x7FEB_352D);
    let word = (word ^ (word >> 15)).wrapping_mul(0x846C_A68B);
    word ^ (word >> 16)
}

/// A hash of a cell of a grid.
pub(super) const fn of_cell(seed: u32, x: i32, y: i32) -> u32 {
    scramble(scramble(x as u32 ^ seed).wrapping_add(y as u32))
}

/// 0 to 1, 1 excluded.
pub(crate) const fn share(hash: u32) -> f32 {
    (hash >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// The cell of a coordinate, and the way into it, 0 to 1.
pub(super) fn split(coordinate: f32) -> (i32, f32) {
    // Casts saturate; `floor` of `libm` is a call on machines without an instruction for it.
    let truncated = coordinate as i32;
    let cell = truncated - i32::from((truncated as f32) > coordinate);
    (cell, coordinate - cell as f32)
}

/// Noise that changes smoothly over one unit: 0 to 1.
pub(super) fn smooth(seed: u32, x: f32, y: f32) -> f32 {
    let ((column, u), (row, v)) = (split(x), split(y));
    let (u, v) = (u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v));
    let corner = |right, up| {
        share(of_cell(
            seed,
            column.wrapping_add(right),
            row.wrapping_add(up),
        ))
    };
    let low = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * u;
    let high = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * u;
    low + (high - low) * v
}

/// A stream of numbers of a seed.
#[derive(Debug, Clone)]
pub(crate) struct Draws(u32);

impl Draws {
    pub(crate) const fn new(seed: u32, what: u32) -> Self {
        Self(scramble(seed ^ scramble(what)))
    }

    pub(crate) const fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9);
        scramble(self.0)
    }

    /// Between two numbers, the second excluded.
    pub(crate) const fn between(&mut self, least: f32, most: f32) -> f32 {
        least + (most - least) * share(self.next())
    }
}
