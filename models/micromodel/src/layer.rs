//! One layer, as the blob describes it.

use crate::blob::{self, HEADER, LAYER, MAX_EXTENT, MAX_LAYERS};
use crate::error::ModelError;

/// Rows, columns and channels of a tensor, none of them zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Rows.
    pub height: u16,
    /// Columns.
    pub width: u16,
    /// Channels: values of a pixel, which lie side by side.
    pub channels: u16,
}

impl Shape {
    /// Values of one row.
    pub const fn row(self) -> usize {
        self.width as usize * self.channels as usize
    }

    /// Values of all rows.
    pub const fn values(self) -> usize {
        self.row() * self.height as usize
    }

    pub(crate) const fn is_valid(self) -> bool {
        let most = MAX_EXTENT;
        self.height > 0
            && self.width > 0
            && self.channels > 0
            && self.height <= most
            && self.width <= most
            && self.channels <= most
    }
}

/// What a layer does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// Every output channel looks at all input channels. With a kernel of one pixel it is
    /// *pointwise*, and on an input of one pixel *fully connected*.
    Convolution,
    /// Every output channel looks at its own input channel.
    Depthwise,
    /// The sum of two tensors of one shape.
    Sum,
}

/// One layer, as the blob describes it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layer {
    pub(crate) operation: Operation,
    pub(crate) kernel: u8,
    pub(crate) stride: u8,
    pub(crate) before: u8,
    pub(crate) after: u8,
    pub(crate) zero: i8,
    pub(crate) lowest: i8,
    pub(crate) highest: i8,
    pub(crate) input: u16,
    pub(crate) other: u16,
    pub(crate) channels: u16,
    /// `sa`, `sb`, `s` of a sum.
    pub(crate) shifts: [u8; 3],
    pub(crate) weights: u32,
    pub(crate) bias: u32,
    pub(crate) scales: u32,
}

pub(crate) const fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

pub(crate) const fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

impl Layer {
    /// A convolution of one pixel and one channel, to be changed.
    pub(crate) const PLAIN: Self = Self {
        operation: Operation::Convolution,
        kernel: 1,
        stride: 1,
        before: 0,
        after: 0,
        zero: 0,
        lowest: 0,
        highest: 0,
        input: 0,
        other: 0,
        channels: 1,
        shifts: [0; 3],
        weights: 0,
        bias: 0,
        scales: 0,
    };

    /// The layer that makes tensor `tensor`, from 1. What is read here was checked before, or is
    /// checked next.
    ///
    /// # Errors
    /// An operation that there is not.
    pub(crate) const fn read(blob: &[u8], tensor: usize) -> Result<Self, ModelError> {
        let at = HEADER + (tensor - 1) * LAYER;
        let operation = match blob[at] {
            1 => Operation::Convolution,
            2 => Operation::Depthwise,
            3 => Operation::Sum,
            _ => return Err(ModelError::Layer(tensor as u16)),
        };
        Ok(Self {
            operation,
            kernel: blob[at + 1],
            stride: blob[at + 2],
            before: blob[at + 3],
            after: blob[at + 4],
            zero: blob[at + 5] as i8,
            lowest: blob[at + 6] as i8,
            highest: blob[at + 7] as i8,
            input: u16_at(blob, at + 8),
            other: u16_at(blob, at + 10),
            channels: u16_at(blob, at + 12),
            shifts: [blob[at + 14], blob[at + 15], blob[at + 16]],
            weights: u32_at(blob, at + 20),
            bias: u32_at(blob, at + 24),
            scales: u32_at(blob, at + 28),
        })
    }

    /// Weights of one output channel.
    pub(crate) const fn patch(&self, input: Shape) -> usize {
        let pixels = self.kernel as usize * self.kernel as usize;
        match self.operation {
            Operation::Convolution => pixels * input.channels as usize,
            Operation::Depthwise => pixels,
            Operation::Sum => 0,
        }
    }

    /// The shape that comes out, when everything about the layer makes sense.
    ///
    /// # Errors
    /// `Layer` with `tensor`.
    pub(crate) const fn shape(
        &self,
        tensor: usize,
        shapes: &[Shape; MAX_LAYERS + 1],
    ) -> Result<Shape, ModelError> {
        let wrong = Err(ModelError::Layer(tensor as u16));
        if self.input as usize >= tensor || self.lowest > self.highest {
            return wrong;
        }
        let input = shapes[self.input as usize];
        let plain = self.kernel == 1 && self.stride == 1 && self.before == 0 && self.after == 0;
        if let Operation::Sum = self.operation {
            let [a, b, all] = self.shifts;
            if !plain || self.other as usize >= tensor || self.other == self.input {
                return wrong;
            }
            let other = shapes[self.other as usize];
            let alike = input.height == other.height
                && input.width == other.width
                && input.channels == other.channels
                && input.channels == self.channels;
            let fine = a <= blob::MAX_LIFT && b <= blob::MAX_LIFT && all <= blob::MAX_SHIFT;
            return if alike && fine && all > 0 {
                Ok(input)
            } else {
                wrong
            };
        }
        let kernel = self.kernel as u16;
        let depthwise = matches!(self.operation, Operation::Depthwise);
        if self.kernel == 0
            || self.kernel > blob::MAX_KERNEL
            || self.stride == 0
            || self.stride > blob::MAX_STRIDE
            || self.before >= self.kernel
            || self.after >= self.kernel
            || (depthwise && self.channels != input.channels)
            || (!depthwise && self.kernel > 1 && self.patch(input) > blob::MAX_PATCH)
        {
            return wrong;
        }
        let around = self.before as u16 + self.after as u16;
        if input.height + around < kernel || input.width + around < kernel {
            return wrong;
        }
        let shape = Shape {
            height: (input.height + around - kernel) / self.stride as u16 + 1,
            width: (input.width + around - kernel) / self.stride as u16 + 1,
            channels: self.channels,
        };
        if shape.is_valid() { Ok(shape) } else { wrong }
    }

    /// Rows of the input that must be there before row `row` of the output can be computed.
    pub(crate) const fn rows_until(&self, row: usize, height: usize) -> usize {
        let rows = row * self.stride as usize + self.kernel as usize;
        let rows = rows.saturating_sub(self.before as usize);
        if rows > height { height } else { rows }
    }

    /// The first row of the input that row `row` of the output looks at.
    pub(crate) const fn first_row(&self, row: usize) -> usize {
        (row * self.stride as usize).saturating_sub(self.before as usize)
    }
}

#[cfg(test)]
#[path = "layer_tests.rs"]
mod tests;
