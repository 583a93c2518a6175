//! Writing blobs, into any buffer.

use crate::blob::{self, HEADER, LAYER, MAX_LAYERS};
use crate::error::ModelError;
use crate::kernels::{weight_at, weight_bytes};
use crate::layer::{Layer, Operation, Shape};
use crate::model::Model;

/// A convolution, depthwise or not, with its numbers.
#[derive(Debug, Clone, Copy)]
pub struct Convolution<'w> {
    /// Each output channel looks at its own input channel only.
    pub depthwise: bool,
    /// Tensor that it looks at; 0 is the input.
    pub input: u16,
    /// Output channels.
    pub channels: u16,
    /// Height and width of the kernel.
    pub kernel: u8,
    /// Rows and columns from one output to the next.
    pub stride: u8,
    /// Padding above and left, below and right.
    pub padding: [u8; 2],
    /// Zero point of the output.
    pub zero: i8,
    /// Lowest and highest output.
    pub range: [i8; 2],
    /// `[out][ky][kx][in]`, depthwise `[ky][kx][channel]`.
    pub weights: &'w [i8],
    /// `bias − zx·Σw` for each output channel.
    pub bias: &'w [i32],
    /// `m` for each output channel.
    pub multipliers: &'w [u8],
    /// `s` for each output channel.
    pub shifts: &'w [u8],
}

/// A sum of two tensors.
#[derive(Debug, Clone, Copy)]
pub struct Sum {
    /// The two tensors.
    pub inputs: [u16; 2],
    /// `sa` and `sb`.
    pub lifts: [u8; 2],
    /// `s`.
    pub shift: u8,
    /// Zero point of the output.
    pub zero: i8,
    /// Lowest and highest output.
    pub range: [i8; 2],
}

/// Writes a blob into a buffer.
#[derive(Debug)]
pub struct Writer<'b> {
    blob: &'b mut [u8],
    layers: usize,
    written: usize,
    end: usize,
    shapes: [Shape; MAX_LAYERS + 1],
}

impl<'b> Writer<'b> {
    /// A model of `layers` layers.
    ///
    /// # Errors
    /// [`ModelError::Full`] when header and layers do not fit, [`ModelError::Layer`] of layer 0 when
    /// the shape or number makes no sense.
    pub fn new(
        blob: &'b mut [u8],
        input: Shape,
        input_zero: i8,
        layers: usize,
    ) -> Result<Self, ModelError> {
        if layers == 0 || layers > MAX_LAYERS || !input.is_valid() {
            return Err(ModelError::Layer(0));
        }
        let end = HEADER + layers * LAYER;
        let head = blob.get_mut(..end).ok_or(ModelError::Full)?;
        head.fill(0);
        head[..4].copy_from_slice(&blob::MAGIC);
        head[4..6].copy_from_slice(&blob::VERSION.to_le_bytes());
        head[6..8].copy_from_slice(&(layers as u16).to_le_bytes());
        head[16..18].copy_from_slice(&input.height.to_le_bytes());
        head[18..20].copy_from_slice(&input.width.to_le_bytes());
        head[20..22].copy_from_slice(&input.channels.to_le_bytes());
        head[22] = input_zero as u8;
        Ok(Self {
            blob,
            layers,
            written: 0,
            end,
            shapes: [input; MAX_LAYERS + 1],
        })
    }

    fn append(&mut self, bytes: impl ExactSizeIterator<Item = u8>) -> Result<u32, ModelError> {
        let at = self.end;
        let end = at + bytes.len();
        let room = self.blob.get_mut(at..end).ok_or(ModelError::Full)?;
        for (to, byte) in room.iter_mut().zip(bytes) {
            *to = byte;
        }
        self.end = end;
        Ok(at as u32)
    }

    /// Adds a convolution, and returns the tensor that it makes and its shape.
    ///
    /// # Errors
    /// [`ModelError::Layer`] when it makes no sense, [`ModelError::Mismatch`] when there are more
    /// layers than announced or another number of weights than the shape asks for,
    /// [`ModelError::Full`].
    pub fn convolution(&mut self, it: &Convolution<'_>) -> Result<(u16, Shape), ModelError> {
        let channels = usize::from(it.channels);
        let operation = if it.depthwise {
            Operation::Depthwise
        } else {
            Operation::Convolution
        };
        let mut layer = Layer {
            operation,
            kernel: it.kernel,
            stride: it.stride,
            before: it.padding[0],
            after: it.padding[1],
            zero: it.zero,
            lowest: it.range[0],
            highest: it.range[1],
            input: it.input,
            channels: it.channels,
            ..Layer::PLAIN
        };
        let shape = self.fitting(&layer)?;
        let patch = layer.patch(self.shapes[usize::from(it.input)]);
        if it.weights.len() != patch * channels
            || [it.bias.len(), it.multipliers.len(), it.shifts.len()] != [channels; 3]
        {
            return Err(ModelError::Mismatch);
        }
        layer.weights = if it.depthwise {
            self.append(it.weights.iter().map(|&weight| weight as u8))?
        } else {
            let at = self.append(core::iter::repeat_n(0, weight_bytes(channels, patch)))?;
            let room = &mut self.blob[at as usize..self.end];
            for (number, &weight) in it.weights.iter().enumerate() {
                room[weight_at(number / patch, number % patch, patch)] = weight as u8;
            }
            at
        };
        layer.bias = self.end as u32;
        for bias in it.bias {
            self.append(bias.to_le_bytes().into_iter())?;
        }
        layer.scales = self.append(it.multipliers.iter().copied())?;
        self.append(it.shifts.iter().copied())?;
        Ok(self.add(&layer, shape))
    }

    /// Adds a sum, and returns the tensor that it makes and its shape.
    ///
    /// # Errors
    /// Like [`Writer::convolution`].
    pub fn sum(&mut self, it: &Sum) -> Result<(u16, Shape), ModelError> {
        let [input, other] = it.inputs;
        let known = self.shapes.get(..=self.written).unwrap_or(&[]);
        let channels = known
            .get(usize::from(input))
            .ok_or(ModelError::Mismatch)?
            .channels;
        let layer = Layer {
            operation: Operation::Sum,
            zero: it.zero,
            lowest: it.range[0],
            highest: it.range[1],
            input,
            other,
            channels,
            shifts: [it.lifts[0], it.lifts[1], it.shift],
            ..Layer::PLAIN
        };
        let shape = self.fitting(&layer)?;
        Ok(self.add(&layer, shape))
    }

    fn fitting(&self, layer: &Layer) -> Result<Shape, ModelError> {
        if self.written == self.layers {
            return Err(ModelError::Mismatch);
        }
        layer.shape(self.written + 1, &self.shapes)
    }

    fn add(&mut self, layer: &Layer, shape: Shape) -> (u16, Shape) {
        let record = &mut self.blob[HEADER + self.written * LAYER..][..LAYER];
        record[0] = match layer.operation {
            Operation::Convolution => 1,
            Operation::Depthwise => 2,
            Operation::Sum => 3,
        };
        record[1..5].copy_from_slice(&[layer.kernel, layer.stride, layer.before, layer.after]);
        record[5..8].copy_from_slice(&[layer.zero, layer.lowest, layer.highest].map(|v| v as u8));
        record[8..10].copy_from_slice(&layer.input.to_le_bytes());
        record[10..12].copy_from_slice(&layer.other.to_le_bytes());
        record[12..14].copy_from_slice(&layer.channels.to_le_bytes());
        record[14..17].copy_from_slice(&layer.shifts);
        record[20..24].copy_from_slice(&layer.weights.to_le_bytes());
        record[24..28].copy_from_slice(&layer.bias.to_le_bytes());
        record[28..32].copy_from_slice(&layer.scales.to_le_bytes());
        self.written += 1;
        self.shapes[self.written] = shape;
        (self.written as u16, shape)
    }

    /// Adds what a step of the output is, 2 to the power of `exponent`, what its channels stand for,
    /// and the checksum. Returns the length of the blob, which is a [`Model`].
    ///
    /// # Errors
    /// What is wrong with the model.
    pub fn finish(mut self, exponent: i8, labels: &[&str]) -> Result<usize, ModelError> {
        if self.written != self.layers {
            return Err(ModelError::Mismatch);
        }
        self.blob[23] = exponent as u8;
        let at = self.end as u32;
        for label in labels {
            let length = u8::try_from(label.len()).map_err(|_| ModelError::Labels)?;
            self.append(core::iter::once(length))?;
            self.append(label.bytes())?;
        }
        let end = self.end;
        self.blob[24..28].copy_from_slice(&at.to_le_bytes());
        let count = u16::try_from(labels.len()).map_err(|_| ModelError::Labels)?;
        self.blob[28..30].copy_from_slice(&count.to_le_bytes());
        self.blob[8..12].copy_from_slice(&(end as u32).to_le_bytes());
        let checksum = blob::checksum(&self.blob[16..end]);
        self.blob[12..16].copy_from_slice(&checksum.to_le_bytes());
        Model::new(&self.blob[..end])?;
        Ok(end)
    }
}
