//! Convolutions whose outputs look at all input channels.
//!
//! Weights lie in groups of [`GROUP`] output channels, and within a group tap by tap: what an input
//! is multiplied with lies side by side.

use super::finish::Finish;
use super::{GROUP, Rows, SCRATCH, Scratch, VECTORS, begin, wide};
use crate::blob::MAX_PATCH;
use crate::layer::Layer;
use crate::model::Numbers;

/// Output channels that are summed at once: half a group, with whose sums a chip's registers are
/// full.
const LANES: usize = 4;
/// Pixels that are summed at once.
const PIXELS: usize = 2;

/// Pixels whose sums wait for their outputs.
const BLOCK: usize = 8;

/// Inputs that are laid side by side at once.
const GATHERED: usize = if VECTORS { SCRATCH } else { PIXELS * MAX_PATCH };

/// Row `row` of a convolution.
#[cfg_attr(target_pointer_width = "64", inline(always))]
pub(crate) fn convolution(
    layer: &Layer,
    numbers: &Numbers<'_>,
    input: Rows<'_>,
    row: usize,
    out: &mut [i8],
    scratch: &mut Scratch,
) {
    let patch = layer.patch(input.shape);
    let plain = layer.kernel == 1 && layer.stride == 1 && layer.before == 0;
    if plain {
        if let Some(pixels) = input.row(row as isize) {
            pointwise(layer, numbers, (pixels, patch), out, scratch);
        }
        return;
    }
    // Other kernels: what they look at is laid side by side first.
    let channels = usize::from(layer.channels);
    let mut patches = [0; GATHERED];
    let block = GATHERED / patch;
    for (number, outs) in out.chunks_mut(block * channels).enumerate() {
        let pixels = outs.len() / channels;
        let patches = &mut patches[..pixels * patch];
        for (n, place) in patches.chunks_exact_mut(patch).enumerate() {
            gather(layer, input, row, number * block + n, place);
        }
        pointwise(layer, numbers, (patches, patch), outs, scratch);
    }
}

/// Copies what the kernel at an output looks at.
fn gather(layer: &Layer, input: Rows<'_>, row: usize, column: usize, patch: &mut [i8]) {
    let channels = usize::from(input.shape.channels);
    let kernel = usize::from(layer.kernel);
    let (top, left) = (begin(layer, row), begin(layer, column));
    for (y, line) in patch.chunks_exact_mut(kernel * channels).enumerate() {
        let from = input.row(top + y as isize);
        if let Some(values) = Rows::pixel(from, left, channels)
            .and_then(|_| from?.get(left as usize * channels..)?.get(..line.len()))
        {
            line.copy_from_slice(values);
            continue;
        }
        for (x, pixel) in line.chunks_exact_mut(channels).enumerate() {
            match Rows::pixel(from, left + x as isize, channels) {
                Some(values) => pixel.copy_from_slice(values),
                None => pixel.fill(input.zero),
            }
        }
    }
}

/// Every output channel of every pixel: `inputs` has `patch` values for each.
#[cfg_attr(target_pointer_width = "64", inline(always))]
fn pointwise(
    layer: &Layer,
    numbers: &Numbers<'_>,
    (inputs, patch): (&[i8], usize),
    out: &mut [i8],
    scratch: &mut Scratch,
) {
    if VECTORS && numbers.exact_in_floats {
        wide::pointwise(layer, numbers, (inputs, patch), out, scratch);
    } else {
        by_halves(layer, numbers, (inputs, patch), out);
    }
}

/// Half a group of output channels at a time.
fn by_halves(
    layer: &Layer,
    numbers: &Numbers<'_>,
    (inputs, patch): (&[i8], usize),
    out: &mut [i8],
) {
    let channels = usize::from(layer.channels);
    let groups = numbers.weights.chunks_exact(GROUP * patch);
    let mut sums = [[0; LANES]; BLOCK];
    for (first, weights) in (0..channels).step_by(GROUP).zip(groups) {
        let half = |first| Half {
            weights,
            finish: Finish::of(layer, numbers, first),
            patch,
            channels,
            first,
        };
        half(first).run::<0>(inputs, out, &mut sums);
        if first + LANES < channels {
            half(first + LANES).run::<LANES>(inputs, out, &mut sums);
        }
    }
}

/// Some output channels, from `first` of `channels` on, of every pixel.
struct Half<'a> {
    /// Of the whole group.
    weights: &'a [u8],
    finish: Finish<LANES>,
    patch: usize,
    channels: usize,
    first: usize,
}

impl Half<'_> {
    /// `FROM` is where in a group it begins.
    #[inline]
    fn run<const FROM: usize>(
        &self,
        inputs: &[i8],
        out: &mut [i8],
        sums: &mut [[i32; LANES]; BLOCK],
    ) {
        let blocks = out.chunks_mut(BLOCK * self.channels);
        for (inputs, out) in inputs.chunks(BLOCK * self.patch).zip(blocks) {
            products::<FROM>(self.weights, inputs, self.patch, &self.finish.bias, sums);
            self.store(sums, out);
        }
    }

    #[inline]
    fn store(&self, sums: &[[i32; LANES]; BLOCK], out: &mut [i8]) {
        for (out, sums) in out.chunks_exact_mut(self.channels).zip(sums) {
            let out = &mut out[self.first..];
            if let Some(out) = out.first_chunk_mut() {
                self.finish.outputs(sums, out);
            } else {
                let mut values = [0; LANES];
                self.finish.outputs(sums, &mut values);
                for (out, value) in out.iter_mut().zip(values) {
                    *out = value;
                }
            }
        }
    }
}

/// Sums of a block of pixels that look at `patch` values each. A function of its own, so that it
/// has all registers of a small chip.
#[inline(never)]
fn products<const FROM: usize>(
    weights: &[u8],
    inputs: &[i8],
    patch: usize,
    bias: &[i32; LANES],
    sums: &mut [[i32; LANES]; BLOCK],
) {
    let mut sets = inputs.chunks_exact(PIXELS * patch);
    let mut places = sums.chunks_exact_mut(PIXELS);
    for (inputs, place) in sets.by_ref().zip(places.by_ref()) {
        let (one, other) = inputs.split_at(patch);
        let both = two_pixels::<FROM>(weights, one, other, bias);
        place.copy_from_slice(&both);
    }
    let last = sets.remainder();
    if let ([_, ..], Some([place, ..])) = (last, places.next()) {
        [*place, _] = two_pixels::<FROM>(weights, last, last, bias);
    }
}

#[inline]
fn two_pixels<const FROM: usize>(
    weights: &[u8],
    one: &[i8],
    other: &[i8],
    bias: &[i32; LANES],
) -> [[i32; LANES]; PIXELS] {
    let (mut left, mut right) = (*bias, *bias);
    let (taps, _) = weights.as_chunks::<GROUP>();
    for ((taps, &one), &other) in taps.iter().zip(one).zip(other) {
        let (one, other) = (i32::from(one), i32::from(other));
        for lane in 0..LANES {
            let weight = i32::from(taps[FROM + lane] as i8);
            left[lane] += weight * one;
            right[lane] += weight * other;
        }
    }
    [left, right]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::tests::noise;
    use crate::kernels::weight_bytes;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn both_ways_lead_to_the_same(
            channels in 1_usize..40,
            patch in 1_usize..60,
            pixels in 1_usize..40,
            seed: u32,
        ) {
            let mut byte = noise(seed);
            let layer = Layer {
                zero: -7,
                lowest: -128,
                highest: 100,
                channels: channels as u16,
                ..Layer::PLAIN
            };
            let weights: Vec<u8> = (0..weight_bytes(channels, patch)).map(|_| byte()).collect();
            let bias: Vec<u8> = (0..channels).flat_map(|_| [byte(), byte(), 0, 0]).collect();
            // 60 products of 128 by 128, and the bias: a multiplier up to 15 leaves them exact.
            let multipliers: Vec<u8> = (0..channels).map(|_| byte() % 15 + 1).collect();
            let shifts: Vec<u8> = (0..channels).map(|_| byte() % 12 + 4).collect();
            let numbers = Numbers::new(&weights, &bias, &multipliers, &shifts);
            let inputs: Vec<i8> = (0..pixels * patch).map(|_| byte() as i8).collect();
            let mut outs = [(); 2].map(|()| vec![0; pixels * channels]);
            let [one, other] = &mut outs;
            by_halves(&layer, &numbers, (&inputs, patch), one);
            let mut scratch = [0.0; SCRATCH];
            wide::pointwise(&layer, &numbers, (&inputs, patch), other, &mut scratch);
            prop_assert_eq!(one, other);
        }
    }
}
