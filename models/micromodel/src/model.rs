//! A blob that was looked through and found to be a model.

use crate::blob::{self, HEADER, LAYER};
use crate::error::ModelError;
use crate::kernels::{weight_at, weight_bytes};
use crate::layer::{Layer, Operation, Shape, u16_at, u32_at};
use crate::plan::Plan;

/// A blob that was looked through and found to be a model. Nothing of it is copied.
#[derive(Debug, Clone, Copy)]
pub struct Model<'m> {
    blob: &'m [u8],
    plan: Plan,
    /// Bit by bit, the layers whose products have no more than 24 bits.
    exact_in_floats: u64,
}

/// Weights and numbers of one layer, where they lie.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Numbers<'m> {
    pub(crate) weights: &'m [u8],
    bias: &'m [u8],
    multipliers: &'m [u8],
    shifts: &'m [u8],
    /// No product of sum and multiplier has more than 24 bits.
    pub(crate) exact_in_floats: bool,
}

#[cfg(test)]
impl<'m> Numbers<'m> {
    pub(crate) fn new(
        weights: &'m [u8],
        bias: &'m [u8],
        multipliers: &'m [u8],
        shifts: &'m [u8],
    ) -> Self {
        Self {
            weights,
            bias,
            multipliers,
            shifts,
            exact_in_floats: false,
        }
    }
}

impl Numbers<'_> {
    /// `bias'`, `m` and `s` of the output channels from `first` on.
    #[inline]
    pub(crate) fn from(&self, first: usize) -> impl Iterator<Item = (i32, i32, u32)> + '_ {
        let (bias, _) = self.bias.as_chunks::<4>();
        let scales = self.multipliers.iter().zip(self.shifts);
        let numbers = bias.iter().zip(scales).skip(first);
        numbers.map(|(bias, (&multiplier, &shift))| {
            let bias = i32::from_le_bytes(*bias);
            (bias, i32::from(multiplier), u32::from(shift))
        })
    }
}

impl<'m> Model<'m> {
    /// Reads a blob, all of it: structure, checksum, and that no sum can overflow.
    ///
    /// # Errors
    /// What is wrong with it. Every blob is safe to try.
    pub fn new(blob: &'m [u8]) -> Result<Self, ModelError> {
        let plan = Plan::of(blob)?;
        if blob::checksum(&blob[16..]) != u32_at(blob, 12) {
            return Err(ModelError::Checksum);
        }
        let mut model = Self {
            blob,
            plan,
            exact_in_floats: 0,
        };
        for tensor in 1..=plan.layers {
            if model.check(tensor)? < 1 << 24 {
                model.exact_in_floats |= 1 << tensor;
            }
        }
        model.check_labels()?;
        Ok(model)
    }

    /// Shape of the input.
    pub fn input(&self) -> Shape {
        self.plan.shapes[0]
    }

    /// Shape of the output.
    pub fn output(&self) -> Shape {
        self.plan.shapes[self.plan.layers]
    }

    /// The number that stands for 0 in the input.
    pub fn input_zero(&self) -> i8 {
        self.blob[22] as i8
    }

    /// A value of the output is so many times 2 to the power of this.
    pub fn output_exponent(&self) -> i8 {
        self.blob[23] as i8
    }

    /// Bytes that a [`crate::Runner`] of this model needs.
    pub fn arena_bytes(&self) -> usize {
        self.plan.bytes()
    }

    /// Bytes of the blob.
    pub fn bytes(&self) -> usize {
        self.blob.len()
    }

    /// Multiplications of one run.
    pub fn multiplications(&self) -> u64 {
        (1..=self.plan.layers)
            .map(|tensor| {
                let layer = self.layer(tensor);
                let patch = layer.patch(self.plan.shapes[layer.input as usize]);
                self.plan.shapes[tensor].values() as u64 * patch as u64
            })
            .sum()
    }

    /// What the channels of the output stand for. Empty when the model does not say.
    pub fn labels(&self) -> impl Iterator<Item = &'m str> + use<'m> {
        let mut rest = &self.blob[u32_at(self.blob, 24) as usize..];
        (0..u16_at(self.blob, 28)).map_while(move |_| {
            let (length, after) = rest.split_first()?;
            let (label, after) = after.split_at_checked(usize::from(*length))?;
            rest = after;
            core::str::from_utf8(label).ok()
        })
    }

    pub(crate) fn plan(&self) -> &Plan {
        &self.plan
    }

    pub(crate) fn blob(&self) -> &'m [u8] {
        self.blob
    }

    /// The layer that makes a tensor.
    pub(crate) fn layer(&self, tensor: usize) -> Layer {
        // The operation was read before; a convolution is what there is in any case.
        Layer::read(self.blob, tensor).unwrap_or(Layer::PLAIN)
    }

    /// The zero point of a tensor.
    pub(crate) fn zero(&self, tensor: usize) -> i8 {
        if tensor == 0 {
            self.input_zero()
        } else {
            self.blob[HEADER + (tensor - 1) * LAYER + 5] as i8
        }
    }

    fn part(&self, offset: u32, length: usize) -> Result<&'m [u8], ModelError> {
        let offset = offset as usize;
        let end = offset.checked_add(length).ok_or(ModelError::Truncated)?;
        self.blob.get(offset..end).ok_or(ModelError::Truncated)
    }

    /// Weights and numbers of the layer that makes a tensor, which is no sum.
    ///
    /// # Errors
    /// When they are not inside the blob.
    pub(crate) fn numbers(&self, tensor: usize, layer: &Layer) -> Result<Numbers<'m>, ModelError> {
        let channels = usize::from(layer.channels);
        let patch = layer.patch(self.plan.shapes[usize::from(layer.input)]);
        let scales = self.part(layer.scales, 2 * channels)?;
        let (multipliers, shifts) = scales.split_at(channels);
        let weights = if layer.operation == Operation::Depthwise {
            patch * channels
        } else {
            weight_bytes(channels, patch)
        };
        Ok(Numbers {
            weights: self.part(layer.weights, weights)?,
            bias: self.part(layer.bias, 4 * channels)?,
            multipliers,
            shifts,
            exact_in_floats: self.exact_in_floats >> tensor & 1 == 1,
        })
    }

    /// Everything is there, and no sum leaves an i32 for any input. The largest product of a sum
    /// and its multiplier that there can be.
    fn check(&self, tensor: usize) -> Result<u64, ModelError> {
        let layer = self.layer(tensor);
        if layer.operation == Operation::Sum {
            // 2 · 255 · 2^12 is far from 2^31.
            return Ok(0);
        }
        let numbers = self.numbers(tensor, &layer)?;
        let channels = usize::from(layer.channels);
        let patch = layer.patch(self.plan.shapes[usize::from(layer.input)]);
        let mut largest = 0;
        for (channel, (bias, multiplier, shift)) in numbers.from(0).enumerate() {
            if shift == 0 || shift > u32::from(blob::MAX_SHIFT) || multiplier == 0 {
                return Err(ModelError::Layer(tensor as u16));
            }
            let (mut lowest, mut highest) = (i64::from(bias), i64::from(bias));
            for tap in 0..patch {
                let at = if layer.operation == Operation::Depthwise {
                    tap * channels + channel
                } else {
                    weight_at(channel, tap, patch)
                };
                let weight = i64::from(numbers.weights[at] as i8);
                let ends = [weight * i64::from(i8::MIN), weight * i64::from(i8::MAX)];
                lowest += ends[0].min(ends[1]);
                highest += ends[0].max(ends[1]);
            }
            let most = lowest.unsigned_abs().max(highest.unsigned_abs());
            largest = largest.max(most * multiplier as u64);
            if shift == 1 {
                // What is rounded in floats has to have a bit less than what is multiplied.
                largest = largest.max(1 << 24);
            }
        }
        // The rounding adds half a step, less than 2^24.
        if largest + (1 << 24) > i32::MAX as u64 {
            return Err(ModelError::Overflow(tensor as u16));
        }
        Ok(largest)
    }

    fn check_labels(&self) -> Result<(), ModelError> {
        let labels = u16_at(self.blob, 28);
        if u32_at(self.blob, 24) as usize > self.blob.len() {
            return Err(ModelError::Truncated);
        }
        let right = labels == 0 || labels == self.output().channels;
        if right && self.labels().count() == usize::from(labels) {
            Ok(())
        } else {
            Err(ModelError::Labels)
        }
    }
}
