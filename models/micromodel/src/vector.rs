//! Layers that look at one vector: what small policies are made of.
//!
//! A picture has many pixels that go through the same weights, so [`crate::Runner`] takes several at once. Of a vector
//! there is one, and everything is loaded for it alone: inputs one after the other, each multiplied with the weights
//! of [`LANES`] outputs that lie side by side.
//!
//! | bytes | of a layer with `n` inputs and `m` outputs, `m` rounded up to a multiple of [`LANES`] |
//! |---:|---|
//! | 4·m | `bias`, i32, little-endian |
//! | m | multipliers, 1 to 255 |
//! | m | shifts, 1 to [`MAX_SHIFT`] |
//! | n·m | weights, i8: group by group of [`LANES`] outputs, within it input by input |
//!
//! An output is `RHE((bias + Σ w·x)·m / 2^s)`, as in [the crate](crate) with zero points of 0, in 32 bits: what it
//! is squeezed through is the business of whoever has the next layer.

use crate::blob::MAX_SHIFT;
use crate::error::ModelError;
use crate::kernels::rounded;

/// Outputs that are summed at once: with their sums, an input and a weight the registers of a chip are not full yet.
pub const LANES: usize = 4;
/// Inputs between two looks at whether there are more.
const AT_ONCE: usize = 4;
/// Most inputs of a layer, and most outputs.
pub const MAX_WIDTH: usize = 128;
/// Products stay below this, so that rounding them cannot overflow.
const MOST: i64 = (1 << 31) - (1 << 24);

/// A layer all of whose outputs look at all of its inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dense<'a> {
    inputs: usize,
    outputs: usize,
    biases: &'a [[u8; 4]],
    multipliers: &'a [u8],
    shifts: &'a [u8],
    weights: &'a [[u8; LANES]],
}

impl<'a> Dense<'a> {
    /// Bytes of a layer with so many inputs and outputs.
    #[must_use]
    pub const fn bytes(inputs: usize, outputs: usize) -> usize {
        outputs.next_multiple_of(LANES) * (4 + 1 + 1 + inputs)
    }

    /// Reads a layer, which is all of `bytes`, where it lies. `number` is its own, for errors.
    ///
    /// # Errors
    /// When the bytes are too few or too many, or sums could overflow.
    pub fn new(
        bytes: &'a [u8],
        inputs: usize,
        outputs: usize,
        number: u16,
    ) -> Result<Self, ModelError> {
        let width = 1..=MAX_WIDTH;
        if !width.contains(&inputs) || !width.contains(&outputs) {
            return Err(ModelError::Layer(number));
        }
        let it = Self::known(bytes, inputs, outputs).ok_or(ModelError::Truncated)?;
        let shift = |shift: &u8| (1..=MAX_SHIFT).contains(shift);
        if it.multipliers.contains(&0) || !it.shifts.iter().all(shift) {
            return Err(ModelError::Layer(number));
        }
        if it.could_overflow() {
            return Err(ModelError::Overflow(number));
        }
        Ok(it)
    }

    /// A layer of bytes that [`Self::new`] has read before, without looking at all of them again. `None` where they cannot
    /// be the same; with others that have the length of a layer there is no telling what it gives.
    #[must_use]
    pub fn known(bytes: &'a [u8], inputs: usize, outputs: usize) -> Option<Self> {
        if inputs == 0 || bytes.len() != Self::bytes(inputs, outputs) {
            return None;
        }
        let padded = outputs.next_multiple_of(LANES);
        let (biases, rest) = bytes.split_at(4 * padded);
        let (multipliers, rest) = rest.split_at(padded);
        let (shifts, weights) = rest.split_at(padded);
        Some(Self {
            inputs,
            outputs,
            biases: biases.as_chunks().0,
            multipliers,
            shifts,
            weights: weights.as_chunks().0,
        })
    }

    /// Whether there are inputs for which a product leaves 32 bits.
    fn could_overflow(&self) -> bool {
        let groups = self.weights.chunks_exact(self.inputs);
        groups.enumerate().any(|(group, weights)| {
            (0..LANES).any(|lane| {
                let output = group * LANES + lane;
                let sum: i64 = weights
                    .iter()
                    .map(|of_input| i64::from(weight(of_input[lane])).abs() * 128)
                    .sum();
                let most = sum + i64::from(self.bias(output)).abs();
                most * i64::from(self.multiplier(output)) >= MOST
            })
        })
    }

    /// How many values it looks at.
    #[must_use]
    pub const fn inputs(&self) -> usize {
        self.inputs
    }

    /// How many values it has.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.outputs
    }

    fn bias(&self, output: usize) -> i32 {
        self.biases
            .get(output)
            .map_or(0, |bytes| i32::from_le_bytes(*bytes))
    }

    fn multiplier(&self, output: usize) -> i32 {
        self.multipliers.get(output).map_or(0, |m| i32::from(*m))
    }

    /// Writes the outputs, as many as there is room for. Inputs that are missing are 0, further ones are not looked at.
    ///
    /// On a chip it is called: so it is built with this crate, for speed, while what is inlined into the robot program
    /// is built for size, and takes three times the instructions.
    #[cfg_attr(target_pointer_width = "64", inline(always))]
    #[cfg_attr(not(target_pointer_width = "64"), inline(never))]
    pub fn run(&self, input: &[i8], outputs: &mut [i32]) {
        let room = outputs.len().min(self.outputs);
        let groups = self.weights.chunks_exact(self.inputs);
        let (biases, _) = self.biases.as_chunks::<LANES>();
        let (multipliers, _) = self.multipliers.as_chunks::<LANES>();
        let (shifts, _) = self.shifts.as_chunks::<LANES>();
        let scales = multipliers.iter().zip(shifts);
        let groups = groups.zip(biases).zip(scales);
        let outputs = outputs[..room].chunks_mut(LANES);
        for (outputs, ((weights, biases), (multipliers, shifts))) in outputs.zip(groups) {
            let sums = sums(input, weights, biases);
            let scales = multipliers.iter().zip(shifts);
            for ((output, sum), (multiplier, shift)) in outputs.iter_mut().zip(sums).zip(scales) {
                *output = rounded(sum * i32::from(*multiplier), u32::from(*shift));
            }
        }
    }
}

/// Sums of a group of outputs.
#[inline(always)]
fn sums(input: &[i8], weights: &[[u8; LANES]], biases: &[[u8; 4]; LANES]) -> [i32; LANES] {
    let mut sums = biases.map(i32::from_le_bytes);
    // By reference: four bytes that are copied are read as a word, and taken apart again.
    let mut add = |value: i8, of_input: &[u8; LANES]| {
        for (sum, byte) in sums.iter_mut().zip(of_input) {
            *sum += i32::from(value) * weight(*byte);
        }
    };
    let count = input.len().min(weights.len());
    let (inputs, last_inputs) = input[..count].as_chunks::<AT_ONCE>();
    let (weights, last_weights) = weights[..count].as_chunks::<AT_ONCE>();
    for (inputs, weights) in inputs.iter().zip(weights) {
        for (value, of_input) in inputs.iter().zip(weights) {
            add(*value, of_input);
        }
    }
    for (value, of_input) in last_inputs.iter().zip(last_weights) {
        add(*value, of_input);
    }
    sums
}

#[inline]
fn weight(byte: u8) -> i32 {
    i32::from(byte.cast_signed())
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    /// A layer as numbers: for each output its bias, multiplier, shift and weights.
    type Numbers = Vec<(i32, u8, u8, Vec<i8>)>;

    fn written(layer: &Numbers, inputs: usize) -> Vec<u8> {
        let nothing = (0, 1, 1, std::vec![0; inputs]);
        let padded = layer.len().next_multiple_of(LANES);
        let all: Vec<_> = (0..padded)
            .map(|n| layer.get(n).unwrap_or(&nothing))
            .collect();
        let mut bytes = Vec::new();
        for output in &all {
            bytes.extend(output.0.to_le_bytes());
        }
        bytes.extend(all.iter().map(|output| output.1));
        bytes.extend(all.iter().map(|output| output.2));
        for group in all.chunks(LANES) {
            for input in 0..inputs {
                bytes.extend(group.iter().map(|output| output.3[input].cast_unsigned()));
            }
        }
        bytes
    }

    fn layer() -> impl Strategy<Value = (Numbers, Vec<i8>)> {
        (1..70_usize).prop_flat_map(|inputs| {
            let weights = prop::collection::vec(any::<i8>(), inputs);
            let output = (-60_000..60_000_i32, 1..=255_u8, 1..=24_u8, weights);
            (
                prop::collection::vec(output, 1..20),
                prop::collection::vec(any::<i8>(), inputs),
            )
        })
    }

    proptest! {
        /// Against the rule in whole numbers without limits, and in halves.
        #[test]
        fn outputs_are_what_the_rule_says((layer, input) in layer()) {
            let bytes = written(&layer, input.len());
            let dense = Dense::new(&bytes, input.len(), layer.len(), 1).unwrap();
            let mut outputs = std::vec![0; layer.len()];
            dense.run(&input, &mut outputs);
            let expected: Vec<i32> = layer.iter().map(|(bias, multiplier, shift, weights)| {
                let sum: i64 = weights.iter().zip(&input).map(|(w, x)| i64::from(*w) * i64::from(*x)).sum();
                let product = (sum + i64::from(*bias)) * i64::from(*multiplier);
                (product as f64 / f64::from(1 << shift)).round_ties_even() as i32
            }).collect();
            prop_assert_eq!(outputs, expected);
        }

        #[test]
        fn no_bytes_and_no_input_make_it_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..400),
            inputs in 0..20_usize,
            outputs in 0..20_usize,
            input in prop::collection::vec(any::<i8>(), 0..40),
        ) {
            let mut bytes = bytes;
            let wanted = Dense::bytes(inputs, outputs);
            if wanted <= 400 && bytes.len() % 2 == 0 {
                bytes.resize(wanted, 1);
            }
            if let Ok(dense) = Dense::new(&bytes, inputs, outputs, 1) {
                for room in [0, outputs, outputs + 3] {
                    let mut values = std::vec![i32::MIN; room];
                    dense.run(&input, &mut values);
                    let written = values.iter().filter(|value| **value != i32::MIN).count();
                    prop_assert_eq!(written, room.min(outputs));
                }
            }
        }
    }

    #[test]
    fn what_could_overflow_is_refused() {
        let inputs = 128;
        let with = |bias, multiplier| {
            let output = (bias, multiplier, 1, std::vec![-128; inputs]);
            Dense::new(&written(&std::vec![output], inputs), inputs, 1, 3).map(|_| ())
        };
        // 128 · 128 · 128 · 255 is 535 million.
        assert_eq!(with(0, 255), Ok(()));
        assert_eq!(with(8_000_000, 255), Err(ModelError::Overflow(3)));
        assert_eq!(with(i32::MIN, 1), Err(ModelError::Overflow(3)));
        assert_eq!(with(0, 0), Err(ModelError::Layer(3)));
    }
}
