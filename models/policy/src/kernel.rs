//! Products of matrices, exact: every element of a product is one sum in order of its terms.

use pulp::{Simd, WithSimd};

/// Columns of every matrix that is multiplied are filled up to a multiple of this, so that vectors of up to so
/// many lanes need no remainder.
pub(crate) const LANES: usize = 8;

/// `columns` filled up.
pub(crate) const fn padded(columns: usize) -> usize {
    columns.div_ceil(LANES) * LANES
}

/// Adds the product of two matrices to a third: `out[r][c] += Σ left[r][k] · right[k][c]`, k rising.
///
/// `TRANSPOSED` says how the left one lies: `left[r · stride + k]`, or `left[k · stride + r]`.
pub(crate) struct Product<'a, const TRANSPOSED: bool> {
    pub(crate) rows: usize,
    /// Length of the sums.
    pub(crate) depth: usize,
    /// A multiple of [`LANES`]; a row of `right` and `out` is so long.
    pub(crate) columns: usize,
    pub(crate) left: &'a [f32],
    pub(crate) stride: usize,
    pub(crate) right: &'a [f32],
    pub(crate) out: &'a mut [f32],
}

impl<const TRANSPOSED: bool> WithSimd for Product<'_, TRANSPOSED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        debug_assert_eq!(self.columns % LANES, 0);
        let (right, _) = S::as_simd_f32s(self.right);
        let (out, _) = S::as_mut_simd_f32s(self.out);
        let width = self.columns / S::F32_LANES;
        let mut strip = Strip::<S, TRANSPOSED> {
            simd,
            depth: self.depth,
            width,
            left: self.left,
            stride: self.stride,
            right: &right[..self.depth * width],
            out: &mut out[..self.rows * width],
        };
        let mut row = 0;
        while row + 4 <= self.rows {
            strip.rows::<4>(row);
            row += 4;
        }
        while row < self.rows {
            strip.rows::<1>(row);
            row += 1;
        }
    }
}

/// A product under way.
struct Strip<'a, S: Simd, const TRANSPOSED: bool> {
    simd: S,
    depth: usize,
    /// Vectors in a row.
    width: usize,
    left: &'a [f32],
    stride: usize,
    right: &'a [S::f32s],
    out: &'a mut [S::f32s],
}

impl<S: Simd, const TRANSPOSED: bool> Strip<'_, S, TRANSPOSED> {
    #[inline(always)]
    fn rows<const ROWS: usize>(&mut self, row: usize) {
        let mut column = 0;
        while column + 2 <= self.width {
            self.block::<ROWS, 2>(row, column);
            column += 2;
        }
        if column < self.width {
            self.block::<ROWS, 1>(row, column);
        }
    }

    /// `ROWS` rows of `VECTORS` vectors, whose sums stay in registers.
    #[inline(always)]
    fn block<const ROWS: usize, const VECTORS: usize>(&mut self, row: usize, column: usize) {
        let (simd, width, stride) = (self.simd, self.width, self.stride);
        let mut sums: [[S::f32s; VECTORS]; ROWS] = core::array::from_fn(|r| {
            let out = &self.out[(row + r) * width + column..][..VECTORS];
            core::array::from_fn(|v| out[v])
        });
        let mut add = |factors: [f32; ROWS], right: &[S::f32s]| {
            let right: [S::f32s; VECTORS] = core::array::from_fn(|v| right[column + v]);
            for (sums, factor) in sums.iter_mut().zip(factors) {
                let factor = simd.splat_f32s(factor);
                for (sum, right) in sums.iter_mut().zip(right) {
                    *sum = simd.add_f32s(*sum, simd.mul_f32s(factor, right));
                }
            }
        };
        let rights = self.right.chunks_exact(width);
        if TRANSPOSED {
            for (k, right) in rights.enumerate() {
                let left = &self.left[k * stride + row..][..ROWS];
                add(core::array::from_fn(|r| left[r]), right);
            }
        } else {
            let left: [&[f32]; ROWS] =
                core::array::from_fn(|r| &self.left[(row + r) * stride..][..self.depth]);
            for (k, right) in rights.enumerate() {
                add(core::array::from_fn(|r| left[r][k]), right);
            }
        }
        for (r, sums) in sums.into_iter().enumerate() {
            self.out[(row + r) * width + column..][..VECTORS].copy_from_slice(&sums);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use proptest::prelude::*;

    use super::*;
    use crate::compute::Compute;

    proptest! {
        #[test]
        fn a_product_is_its_definition_with_vectors_and_without(
            (rows, depth, columns) in (1_usize..10, 1_usize..40, 1_usize..5),
            seed in any::<u32>(),
        ) {
            let columns = columns * LANES;
            let mut next = seed;
            let mut draw = |n: usize| -> Vec<f32> {
                (0..n).map(|_| {
                    next = next.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (next >> 8) as f32 / 8_388_608.0 - 1.0
                }).collect()
            };
            let (left, right, start) = (draw(rows * depth), draw(depth * columns), draw(rows * columns));
            let mut expected = start.clone();
            for r in 0..rows {
                for c in 0..columns {
                    for k in 0..depth {
                        expected[r * columns + c] += left[r * depth + k] * right[k * columns + c];
                    }
                }
            }
            let turned: Vec<f32> =
                (0..depth * rows).map(|i| left[i % rows * depth + i / rows]).collect();
            for compute in [Compute::new(NonZeroUsize::MIN), Compute::without_vectors(NonZeroUsize::MIN)] {
                let mut out = start.clone();
                compute.run(Product::<false> {
                    rows, depth, columns, left: &left, stride: depth, right: &right, out: &mut out,
                });
                prop_assert_eq!(&out, &expected);
                let mut out = start.clone();
                compute.run(Product::<true> {
                    rows, depth, columns, left: &turned, stride: rows, right: &right, out: &mut out,
                });
                prop_assert_eq!(&out, &expected);
            }
        }
    }
}
