//! Convolutions whose outputs look at their own input channel.
//!
//! Chips take a channel at a time, whose nine weights stay in registers, and look at every input
//! once. What that is not made for goes pixel by pixel.

use core::array;

use super::finish::Finish;
use super::{KERNEL, Rows, Scratch, VECTORS, begin, wide};
use crate::layer::Layer;
use crate::model::Numbers;

/// Channels that are summed at once, pixel by pixel.
const LANES: usize = 8;

/// Row `row` of a depthwise convolution.
#[cfg_attr(target_pointer_width = "64", inline(always))]
pub(crate) fn depthwise(
    layer: &Layer,
    numbers: &Numbers<'_>,
    input: Rows<'_>,
    row: usize,
    out: &mut [i8],
    scratch: &mut Scratch,
) {
    let done = if VECTORS && numbers.exact_in_floats {
        wide::depthwise(layer, numbers, input, row, out, scratch)
    } else {
        by_channel(layer, numbers, input, row, out)
    };
    if !done {
        by_pixel(layer, numbers, input, row, out);
    }
}

/// Several channels of a pixel at a time.
fn by_pixel(layer: &Layer, numbers: &Numbers<'_>, input: Rows<'_>, row: usize, out: &mut [i8]) {
    let channels = usize::from(layer.channels);
    let kernel = usize::from(layer.kernel);
    let top = begin(layer, row);
    let outside = [input.zero; LANES];
    let mut rows = [None; crate::blob::MAX_KERNEL as usize];
    for (y, line) in rows.iter_mut().enumerate().take(kernel) {
        *line = input.row(top + y as isize);
    }
    for first in (0..channels).step_by(LANES) {
        let lanes = LANES.min(channels - first);
        let finish = Finish::<LANES>::of(layer, numbers, first);
        for (column, pixel) in out.chunks_exact_mut(channels).enumerate() {
            let left = begin(layer, column);
            let mut sums = finish.bias;
            let mut weights = numbers.weights[first..].chunks(channels);
            for line in &rows[..kernel] {
                for x in 0..kernel {
                    let values = Rows::pixel(*line, left + x as isize, channels)
                        .map_or(&outside[..lanes], |values| &values[first..first + lanes]);
                    let weights = weights.next().map_or(&[][..], |taps| &taps[..lanes]);
                    add_products(&mut sums, weights, values);
                }
            }
            let pixel = &mut pixel[first..];
            if let Some(whole) = pixel.first_chunk_mut() {
                finish.outputs(&sums, whole);
            } else {
                let mut values = [0; LANES];
                finish.outputs(&sums, &mut values);
                pixel.copy_from_slice(&values[..lanes]);
            }
        }
    }
}

#[inline]
fn add_products(sums: &mut [i32; LANES], weights: &[u8], values: &[i8]) {
    if let (Ok(weights), Ok(values)) = (
        <&[u8; LANES]>::try_from(weights),
        <&[i8; LANES]>::try_from(values),
    ) {
        for lane in 0..LANES {
            sums[lane] += i32::from(weights[lane] as i8) * i32::from(values[lane]);
        }
    } else {
        for ((sum, &weight), &value) in sums.iter_mut().zip(weights).zip(values) {
            *sum += i32::from(weight as i8) * i32::from(value);
        }
    }
}

/// A channel at a time; whether that could be done: kernels of 3 × 3, one or two columns apart.
fn by_channel(
    layer: &Layer,
    numbers: &Numbers<'_>,
    input: Rows<'_>,
    row: usize,
    out: &mut [i8],
) -> bool {
    if usize::from(layer.kernel) != KERNEL || !matches!(layer.stride, 1 | 2) || out.is_empty() {
        return false;
    }
    let channels = usize::from(layer.channels);
    let top = begin(layer, row);
    let rows = [0, 1, 2].map(|y| input.row(top + y));
    // Some row to look at in place of one that there is not; its weights are zero then.
    let Some(some) = rows.into_iter().flatten().next() else {
        return false;
    };
    let zero = i32::from(input.zero);
    for channel in 0..channels {
        let finish = Finish::<1>::of(layer, numbers, channel);
        let mut bias = finish.bias[0];
        let mut taps = [[0; KERNEL]; KERNEL];
        for (y, line) in rows.iter().enumerate() {
            for (x, column) in taps.iter_mut().enumerate() {
                let weight = numbers.weights[(y * KERNEL + x) * channels + channel];
                let weight = i32::from(weight as i8);
                if line.is_some() {
                    column[y] = weight;
                } else {
                    bias += weight * zero;
                }
            }
        }
        let line = Line {
            rows: rows.map(|line| &line.unwrap_or(some)[channel..]),
            taps,
            bias,
            step: channels,
            before: usize::from(layer.before),
            zero,
        };
        if layer.stride == 1 {
            line.every(&finish, &mut out[channel..]);
        } else {
            line.every_other(&finish, &mut out[channel..]);
        }
    }
    true
}

/// One channel of the rows that an output row looks at.
struct Line<'a> {
    /// From the channel's first value on.
    rows: [&'a [i8]; KERNEL],
    taps: [[i32; KERNEL]; KERNEL],
    bias: i32,
    /// From a value to the channel's next one.
    step: usize,
    /// Columns outside of the picture that come first.
    before: usize,
    zero: i32,
}

impl Line<'_> {
    /// A column, the first of all being 0.
    #[inline]
    fn column(&self, column: usize) -> [i32; KERNEL] {
        let place = column.checked_sub(self.before).map(|at| at * self.step);
        let value = |row: &[i8]| row.get(place?).copied();
        self.rows.map(|row| value(row).map_or(self.zero, i32::from))
    }

    /// Outputs that lie side by side. A column counts for three of them: sums travel, not values.
    #[inline(never)]
    fn every(&self, finish: &Finish<1>, out: &mut [i8]) {
        let (taps, bias, step) = (self.taps, self.bias, self.step);
        let (one, two) = (self.column(0), self.column(1));
        let mut near = dot(taps[1], two, dot(taps[0], one, bias));
        let mut far = dot(taps[0], two, bias);
        let mut take = |column, out: &mut i8| {
            finish.outputs(&[dot(taps[2], column, near)], array::from_mut(out));
            near = dot(taps[1], column, far);
            far = dot(taps[0], column, bias);
        };
        // The first output's last column is the third one, which is inside.
        let length = self.rows[0].len();
        let [first, second, third] = self.rows.map(|row| &row[..length]);
        let (mut place, mut to) = ((2 - self.before) * step, 0);
        while place < length && to < out.len() {
            let column = [first[place], second[place], third[place]].map(i32::from);
            take(column, &mut out[to]);
            (place, to) = (place + step, to + step);
        }
        while to < out.len() {
            take([self.zero; KERNEL], &mut out[to]);
            to += step;
        }
    }

    /// Outputs two columns apart.
    #[inline(never)]
    fn every_other(&self, finish: &Finish<1>, out: &mut [i8]) {
        let (taps, bias, step) = (self.taps, self.bias, self.step);
        let mut near = dot(taps[0], self.column(0), bias);
        let mut take = |one, two, out: &mut i8| {
            let sum = dot(taps[2], two, dot(taps[1], one, near));
            finish.outputs(&[sum], array::from_mut(out));
            near = dot(taps[0], two, bias);
        };
        let (mut column, mut to) = (1, 0);
        if self.before == 2 {
            take(self.column(1), self.column(2), &mut out[0]);
            (column, to) = (3, step);
        }
        let length = self.rows[0].len();
        let [first, second, third] = self.rows.map(|row| &row[..length]);
        let mut place = (column - self.before) * step;
        while place < length && place + step < length && to < out.len() {
            let one = [first[place], second[place], third[place]].map(i32::from);
            place += step;
            let two = [first[place], second[place], third[place]].map(i32::from);
            take(one, two, &mut out[to]);
            (place, to) = (place + step, to + step);
        }
        while to < out.len() {
            let column = self.before + place / step;
            take(self.column(column), self.column(column + 1), &mut out[to]);
            (place, to) = (place + 2 * step, to + step);
        }
    }
}

#[inline]
fn dot(taps: [i32; KERNEL], column: [i32; KERNEL], sum: i32) -> i32 {
    taps[0] * column[0] + taps[1] * column[1] + taps[2] * column[2] + sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::tests::noise;
    use crate::layer::{Operation, Shape};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn all_ways_lead_to_the_same(
            extent in (1_u16..9, 1_u16..9, 1_u16..17),
            stride in 1_u8..3,
            padding in (0_u8..3, 0_u8..3),
            zero: i8,
            seed: u32,
        ) {
            let (height, width, channels) = extent;
            let around = u16::from(padding.0 + padding.1);
            prop_assume!(height + around >= 3 && width + around >= 3);
            let mut byte = noise(seed);
            let shape = Shape { height, width, channels };
            let count = usize::from(channels);
            let layer = Layer {
                operation: Operation::Depthwise,
                kernel: 3,
                stride,
                before: padding.0,
                after: padding.1,
                zero: 3,
                lowest: -120,
                highest: 125,
                channels,
                ..Layer::PLAIN
            };
            let weights: Vec<u8> = (0..9 * count).map(|_| byte()).collect();
            let bias: Vec<u8> = (0..count).flat_map(|_| [byte(), byte(), 0, 0]).collect();
            let (multipliers, shifts) = (vec![77; count], vec![14; count]);
            let numbers = Numbers::new(&weights, &bias, &multipliers, &shifts);
            let ring: Vec<i8> = (0..shape.values()).map(|_| byte() as i8).collect();
            let kept = usize::from(height);
            let input = Rows { ring: &ring, kept, shape, zero };
            let step = u16::from(stride);
            let [rows, columns] = [height, width].map(|extent| (extent + around - 3) / step + 1);
            let mut outs = [(); 2].map(|()| vec![0; usize::from(columns) * count]);
            let mut scratch = [0.0; crate::kernels::SCRATCH];
            for row in 0..usize::from(rows) {
                let [one, other] = &mut outs;
                by_pixel(&layer, &numbers, input, row, one);
                // Rows of padding alone are left to the other way.
                if by_channel(&layer, &numbers, input, row, other) {
                    prop_assert_eq!(&*one, &*other);
                }
                other.fill(0);
                if wide::depthwise(&layer, &numbers, input, row, other, &mut scratch) {
                    prop_assert_eq!(one, other);
                }
            }
        }
    }
}
