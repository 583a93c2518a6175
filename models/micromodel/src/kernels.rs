//! The inner loops. They are plain loops over arrays of known length: compilers for the host turn
//! them into vector instructions, those for small chips keep sums and weights in registers.
//!
//! There are two ways to the same sums: in integers, for chips, and for layers that are not exact in
//! floats; and in floats, where there are vectors.

mod dense;
mod depthwise;
mod finish;
mod wide;

use crate::layer::{Layer, Shape};

pub(crate) use dense::convolution;
pub(crate) use depthwise::depthwise;
use finish::Range;
pub(crate) use finish::rounded;
pub(crate) use wide::{SCRATCH, Scratch, VECTORS};

/// Output channels whose weights for an input lie side by side.
const GROUP: usize = 8;
/// The kernel of depthwise convolutions that there are faster ways for.
const KERNEL: usize = 3;

/// Bytes of the weights of all groups of a convolution; the last one is filled up.
pub(crate) const fn weight_bytes(channels: usize, patch: usize) -> usize {
    channels.div_ceil(GROUP) * GROUP * patch
}

/// Where the weight of `channel` at `tap` lies.
pub(crate) const fn weight_at(channel: usize, tap: usize, patch: usize) -> usize {
    channel / GROUP * GROUP * patch + tap * GROUP + channel % GROUP
}

/// The rows of a tensor that are in memory.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a> {
    pub(crate) ring: &'a [i8],
    pub(crate) kept: usize,
    pub(crate) shape: Shape,
    pub(crate) zero: i8,
}

impl<'a> Rows<'a> {
    /// A row, `None` outside of the picture.
    #[inline]
    fn row(&self, row: isize) -> Option<&'a [i8]> {
        let row = usize::try_from(row).ok()?;
        if row >= usize::from(self.shape.height) {
            return None;
        }
        let length = self.shape.row();
        self.ring.get((row % self.kept) * length..)?.get(..length)
    }

    /// The channels of a pixel, `None` outside of the picture.
    #[inline]
    fn pixel(row: Option<&'a [i8]>, column: isize, channels: usize) -> Option<&'a [i8]> {
        let column = usize::try_from(column).ok()?;
        row?.get(column * channels..)?.get(..channels)
    }
}

/// Where the kernel of an output's row or column begins.
#[inline]
fn begin(layer: &Layer, at: usize) -> isize {
    (at * usize::from(layer.stride)) as isize - isize::from(layer.before as i8)
}

/// Row `row` of a sum.
pub(crate) fn sum(layer: &Layer, one: Rows<'_>, other: Rows<'_>, row: usize, out: &mut [i8]) {
    let range = Range::of(layer);
    let [lift_one, lift_other, shift] = layer.shifts.map(u32::from);
    let (Some(a), Some(b)) = (one.row(row as isize), other.row(row as isize)) else {
        return;
    };
    let zeros = (i32::from(one.zero) << lift_one) + (i32::from(other.zero) << lift_other);
    for ((out, &a), &b) in out.iter_mut().zip(a).zip(b) {
        let sum = (i32::from(a) << lift_one) + (i32::from(b) << lift_other) - zeros;
        *out = range.output(rounded(sum, shift));
    }
}

#[cfg(test)]
mod tests {
    use super::{weight_at, weight_bytes};
    use std::collections::BTreeSet;

    /// Bytes that look random, of a seed.
    pub(crate) fn noise(seed: u32) -> impl FnMut() -> u8 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        }
    }

    #[test]
    fn every_weight_has_a_place_of_its_own() {
        for (channels, patch) in [(1, 1), (4, 2), (5, 27), (8, 9), (13, 4), (24, 3)] {
            let bytes = weight_bytes(channels, patch);
            let places: BTreeSet<_> = (0..channels)
                .flat_map(|channel| (0..patch).map(move |tap| weight_at(channel, tap, patch)))
                .collect();
            assert_eq!(places.len(), channels * patch);
            assert!(places.last().is_some_and(|&last| last < bytes));
        }
    }
}
