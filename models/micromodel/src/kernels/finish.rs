//! From sums to outputs.

use core::array;

use crate::layer::Layer;
use crate::model::Numbers;

/// Division by a power of two, rounding half to even. `shift` is 1 to 24 and `|value| < 2^31 − 2^24`.
#[inline]
pub(crate) fn rounded(value: i32, shift: u32) -> i32 {
    (value + half(shift) + ((value >> shift) & 1)) >> shift
}

/// Half a step less one: with it, halves are rounded down.
#[inline]
const fn half(shift: u32) -> i32 {
    (1 << (shift - 1)) - 1
}

/// Zero point and limits of an output.
#[derive(Clone, Copy)]
pub(super) struct Range {
    zero: i32,
    lowest: i32,
    highest: i32,
}

impl Range {
    pub(super) fn of(layer: &Layer) -> Self {
        Self {
            zero: i32::from(layer.zero),
            lowest: i32::from(layer.lowest),
            highest: i32::from(layer.highest),
        }
    }

    #[inline]
    pub(super) fn output(self, value: i32) -> i8 {
        let value = self.zero + value;
        let value = if value < self.lowest {
            self.lowest
        } else {
            value
        };
        let value = if value > self.highest {
            self.highest
        } else {
            value
        };
        value as i8
    }
}

/// Numbers of `N` neighbouring channels.
#[derive(Clone, Copy)]
pub(super) struct Finish<const N: usize> {
    /// What sums begin with.
    pub(super) bias: [i32; N],
    multipliers: [i32; N],
    shifts: [u32; N],
    halves: [i32; N],
    range: Range,
}

impl<const N: usize> Finish<N> {
    /// Channels from `first` on. Those beyond the last one come to anything.
    #[cfg_attr(target_pointer_width = "64", inline(always))]
    pub(super) fn of(layer: &Layer, numbers: &Numbers<'_>, first: usize) -> Self {
        let mut it = Self {
            bias: [0; N],
            multipliers: [0; N],
            shifts: [1; N],
            halves: [0; N],
            range: Range::of(layer),
        };
        for (lane, (bias, multiplier, shift)) in numbers.from(first).take(N).enumerate() {
            (it.bias[lane], it.multipliers[lane]) = (bias, multiplier);
            // A model's shifts are 1 to 24.
            (it.shifts[lane], it.halves[lane]) = (shift, half(shift));
        }
        it
    }

    /// Turns sums into outputs.
    #[inline]
    pub(super) fn outputs(&self, sums: &[i32; N], outputs: &mut [i8; N]) {
        for lane in 0..N {
            let (product, shift) = (sums[lane] * self.multipliers[lane], self.shifts[lane]);
            let odd = (product >> shift) & 1;
            outputs[lane] = self
                .range
                .output((product + self.halves[lane] + odd) >> shift);
        }
    }
}

/// The same in f32, several at once where there are vectors, for `N` neighbouring channels of `M`
/// pixels. No product has more than 24 bits, so that none is rounded; what rounds half to even is the
/// sum with a number whose last bit is worth one. Shifts are at least 2.
pub(super) struct FloatFinish<const N: usize, const M: usize> {
    /// Of each pixel the same.
    scales: [[f32; N]; M],
    range: Range,
}

impl<const N: usize, const M: usize> FloatFinish<N, M> {
    /// See [`Finish::of`].
    #[inline(always)]
    pub(super) fn of(exact: &Finish<N>) -> Self {
        let scales = array::from_fn(|lane| {
            // 2^-s, from its exponent.
            let power = f32::from_bits((127 - exact.shifts[lane]) << 23);
            exact.multipliers[lane] as f32 * power
        });
        Self {
            scales: [scales; M],
            range: exact.range,
        }
    }

    /// Turns sums into outputs. One loop for all pixels: compilers unroll shorter ones, and then
    /// miss that there were vectors.
    #[inline(always)]
    pub(super) fn outputs(&self, sums: &[[f32; N]; M]) -> [[i8; N]; M] {
        // 1.5 · 2^23: for ± 2^22, the bits of the sum with it are as far from its own as the number
        // is from 0.
        const WHOLE: f32 = 12_582_912.0;
        let mut outputs = [[0; N]; M];
        let scaled = sums.as_flattened().iter().zip(self.scales.as_flattened());
        for (output, (sum, scale)) in outputs.as_flattened_mut().iter_mut().zip(scaled) {
            let value = (sum * scale + WHOLE).to_bits();
            *output = self
                .range
                .output(value.wrapping_sub(WHOLE.to_bits()) as i32);
        }
        outputs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn halves_go_to_the_even_side(value in -(i32::MAX - (1 << 24))..i32::MAX - (1 << 24), shift in 1_u32..=24) {
            let exact = f64::from(value) / f64::from(1 << shift);
            prop_assert_eq!(f64::from(rounded(value, shift)), exact.round_ties_even());
        }

        #[test]
        fn floats_and_integers_give_the_same(
            product in -(1_i32 << 24) + 1..1 << 24,
            multiplier in 1_i32..256,
            shift in 2_u32..=24,
            zero: i8,
            limits: [i8; 2],
        ) {
            let range = Range {
                zero: i32::from(zero),
                lowest: i32::from(limits[0].min(limits[1])),
                highest: i32::from(limits[0].max(limits[1])),
            };
            let exact = Finish { bias: [0], multipliers: [multiplier], shifts: [shift], halves: [half(shift)], range };
            let floats = FloatFinish::<1, 1>::of(&exact);
            // Halves and their neighbours are where they could differ.
            let half = (product >> shift << shift) + (1 << (shift - 1));
            for sum in [product / multiplier, half / multiplier, half / multiplier + 1] {
                if (sum * multiplier).abs() < 1 << 24 {
                    let mut whole = [0];
                    exact.outputs(&[sum], &mut whole);
                    prop_assert_eq!(floats.outputs(&[[sum as f32]]), [whole]);
                }
            }
        }
    }
}
