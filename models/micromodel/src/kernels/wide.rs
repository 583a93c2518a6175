//! Convolutions on processors with vectors: neighbouring output channels side by side, in f32.
//!
//! Sums of a layer that is exact in floats have no more than 24 bits, whatever their order, so that
//! they are the sums of integers. In f32 a processor multiplies and adds as many at once as in i16,
//! without shuffling, and every compiler finds the vectors by itself.
//!
//! Everything is inlined, so that a caller which was compiled for more than the least processor of
//! its kind gets what that has.

use core::array;

use super::finish::{Finish, FloatFinish};
use super::{GROUP, KERNEL, Rows, begin};
use crate::blob::MAX_PATCH;
use crate::layer::Layer;
use crate::model::Numbers;

/// Channels that are summed at once: a group of weights.
const LANES: usize = GROUP;
/// Pixels that are summed at once, so that a weight is read once for all of them. With their sums
/// they fill the registers.
const PIXELS: usize = 6;

/// Whether processors are expected to have vectors.
pub(crate) const VECTORS: bool = cfg!(target_pointer_width = "64");

/// Inputs that are turned into f32 at once, on hosts only.
pub(crate) const SCRATCH: usize = if VECTORS { PIXELS * MAX_PATCH } else { 0 };

/// Room for them.
pub(crate) type Scratch = [f32; SCRATCH];

/// Every output channel of every pixel: `inputs` has `patch` values for each.
#[inline(always)]
pub(super) fn pointwise(
    layer: &Layer,
    numbers: &Numbers<'_>,
    (inputs, patch): (&[i8], usize),
    out: &mut [i8],
    scratch: &mut Scratch,
) {
    let channels = usize::from(layer.channels);
    // At least one set, since no patch of such a layer is larger than the largest.
    let block = scratch.len() / (PIXELS * patch) * PIXELS;
    let blocks = out.chunks_mut(block * channels);
    for (inputs, out) in inputs.chunks(block * patch).zip(blocks) {
        for (value, &input) in scratch.iter_mut().zip(inputs) {
            *value = f32::from(input);
        }
        let groups = numbers.weights.chunks_exact(LANES * patch);
        for (first, weights) in (0..channels).step_by(LANES).zip(groups) {
            let (bias, finish) = finish(layer, numbers, first);
            // The last set may have fewer pixels; the sums of the others are dropped.
            let sets = scratch.chunks_exact(PIXELS * patch);
            for (values, out) in sets.zip(out.chunks_mut(PIXELS * channels)) {
                let sums = products(weights, values, patch, bias);
                store(&finish.outputs(&sums), out, channels, first);
            }
        }
    }
}

/// Sums of a set of pixels that look at `patch` values each.
#[inline(always)]
fn products(
    weights: &[u8],
    values: &[f32],
    patch: usize,
    bias: [f32; LANES],
) -> [[f32; LANES]; PIXELS] {
    let mut sums = [bias; PIXELS];
    let (weights, _) = weights.as_chunks::<LANES>();
    let mut pixels = values.chunks_exact(patch);
    let [one, two, three, four, five, six] = array::from_fn(|_| pixels.next().unwrap_or(&[]));
    let halves = weights.iter().zip(one).zip(two).zip(three);
    for ((((((weights, one), two), three), four), five), six) in halves.zip(four).zip(five).zip(six)
    {
        let weights = weights.map(|weight| f32::from(weight as i8));
        for (sums, value) in sums.iter_mut().zip([one, two, three, four, five, six]) {
            add_products(sums, &weights, &[*value; LANES]);
        }
    }
    sums
}

/// Row `row` of a depthwise convolution; whether that could be done: kernels of 3 × 3 whose
/// channels are whole groups, and rows that fit.
#[inline(always)]
pub(super) fn depthwise(
    layer: &Layer,
    numbers: &Numbers<'_>,
    input: Rows<'_>,
    row: usize,
    out: &mut [i8],
    scratch: &mut Scratch,
) -> bool {
    let channels = usize::from(layer.channels);
    let before = usize::from(layer.before);
    let columns = before + usize::from(input.shape.width) + usize::from(layer.after);
    // What there is outside of the picture, columns of it included, is laid out with the rest.
    let (room, _) = scratch.as_chunks_mut::<LANES>();
    let fits = KERNEL * columns <= room.len() && channels.is_multiple_of(LANES);
    if usize::from(layer.kernel) != KERNEL || !fits {
        return false;
    }
    let top = begin(layer, row);
    let rows = [0, 1, 2].map(|y| input.row(top + y));
    let outside = [f32::from(input.zero); LANES];
    for first in (0..channels).step_by(LANES) {
        let (bias, finish) = finish(layer, numbers, first);
        let mut lines = room.chunks_exact_mut(columns);
        for (line, row) in lines.by_ref().zip(rows) {
            line.fill(outside);
            let pixels = row.unwrap_or(&[]).chunks_exact(channels);
            for (values, pixel) in line[before..].iter_mut().zip(pixels) {
                *values = eight(&pixel[first..]).map(f32::from);
            }
        }
        let mut taps = [[0.0; LANES]; KERNEL * KERNEL];
        for (tap, weights) in taps.iter_mut().zip(numbers.weights.chunks_exact(channels)) {
            *tap = eight(&weights[first..]).map(|weight| f32::from(weight as i8));
        }
        let step = usize::from(layer.stride);
        let mut lefts = (0..).step_by(step);
        for out in out.chunks_mut(PIXELS * channels) {
            let mut sums = [bias; PIXELS];
            for (sums, left) in sums.iter_mut().take(out.len() / channels).zip(&mut lefts) {
                for (line, taps) in room.chunks_exact(columns).zip(taps.chunks_exact(KERNEL)) {
                    for (values, tap) in line[left..left + KERNEL].iter().zip(taps) {
                        add_products(sums, tap, values);
                    }
                }
            }
            store(&finish.outputs(&sums), out, channels, first);
        }
    }
    true
}

/// What sums of channels from `first` on begin with, and what makes outputs of them.
#[inline(always)]
fn finish(
    layer: &Layer,
    numbers: &Numbers<'_>,
    first: usize,
) -> ([f32; LANES], FloatFinish<LANES, PIXELS>) {
    let exact = Finish::of(layer, numbers, first);
    (exact.bias.map(|bias| bias as f32), FloatFinish::of(&exact))
}

#[inline(always)]
fn add_products(sums: &mut [f32; LANES], weights: &[f32; LANES], values: &[f32; LANES]) {
    for lane in 0..LANES {
        sums[lane] += weights[lane] * values[lane];
    }
}

/// The first eight of them; zeros where there are none.
#[inline(always)]
fn eight<T: Copy + Default>(values: &[T]) -> [T; LANES] {
    values.first_chunk().copied().unwrap_or_default()
}

/// Writes channels from `first` on of a set of pixels, as far as there are such in `out`.
#[inline(always)]
fn store(values: &[[i8; LANES]; PIXELS], out: &mut [i8], channels: usize, first: usize) {
    for (pixel, values) in out.chunks_exact_mut(channels).zip(values) {
        let pixel = &mut pixel[first..];
        if let Some(pixel) = pixel.first_chunk_mut() {
            *pixel = *values;
        } else {
            for (to, value) in pixel.iter_mut().zip(values) {
                *to = *value;
            }
        }
    }
}
