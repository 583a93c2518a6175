//! Layers whose output is not quantised yet, and how they are written when it is.

use crawler_micromodel::{Convolution, Shape, Sum, Writer};

use crate::arithmetic::{fraction, lifts};
use crate::error::ConvertError;
use crate::graph::refused;
use crate::onnx::Node;

/// A tensor of int8.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tensor {
    pub(crate) index: u16,
    pub(crate) shape: Shape,
    /// A step is 2 to the power of this.
    pub(crate) exponent: i32,
    pub(crate) zero: i8,
}

/// A layer whose output is not quantised yet.
#[derive(Debug, Clone)]
pub(crate) struct Pending {
    pub(crate) work: Work,
    pub(crate) low: f32,
    pub(crate) high: f32,
}

#[derive(Debug, Clone)]
pub(crate) enum Work {
    Weighted(Weighted),
    Sum([Tensor; 2]),
}

/// A convolution.
#[derive(Debug, Clone)]
pub(crate) struct Weighted {
    pub(crate) input: Tensor,
    pub(crate) depthwise: bool,
    pub(crate) kernel: u8,
    pub(crate) stride: u8,
    pub(crate) padding: [u8; 2],
    /// As micromodel lays them out.
    pub(crate) weights: Vec<i8>,
    /// One for each output channel; at least one.
    pub(crate) scales: Vec<f32>,
    /// As many.
    pub(crate) bias: Vec<f32>,
}

impl Pending {
    pub(crate) const fn new(work: Work) -> Self {
        Self {
            work,
            low: f32::NEG_INFINITY,
            high: f32::INFINITY,
        }
    }

    /// Writes the layer, whose output `node` quantises to steps of 2 to the power of `power`.
    pub(crate) fn write(
        &self,
        writer: &mut Writer<'_>,
        node: &Node,
        power: i32,
        zero: i8,
    ) -> Result<(u16, Shape), ConvertError> {
        let step = f64::from(power).exp2();
        let bound = |value: f32, otherwise: i8| {
            let steps = f64::from(zero) + f64::from(value) / step;
            if value.is_infinite() {
                Ok(otherwise)
            } else if steps.fract() == 0.0 {
                Ok(steps.clamp(-128.0, 127.0) as i8)
            } else {
                let why = format!("clips at {value}, which is between two steps");
                Err(refused(node, why))
            }
        };
        let range = [bound(self.low, i8::MIN)?, bound(self.high, i8::MAX)?];
        let made = match &self.work {
            Work::Sum([one, other]) => {
                let why = "its scale is too far from those of the summands";
                let (lifts, shift) =
                    lifts(one.exponent, other.exponent, power).ok_or_else(|| refused(node, why))?;
                writer.sum(&Sum {
                    inputs: [one.index, other.index],
                    lifts,
                    shift,
                    zero,
                    range,
                })
            }
            Work::Weighted(layer) => {
                let numbers = layer.numbers(node, step)?;
                writer.convolution(&Convolution {
                    depthwise: layer.depthwise,
                    input: layer.input.index,
                    channels: layer.scales.len() as u16,
                    kernel: layer.kernel,
                    stride: layer.stride,
                    padding: layer.padding,
                    zero,
                    range,
                    weights: &layer.weights,
                    bias: &numbers.bias,
                    multipliers: &numbers.multipliers,
                    shifts: &numbers.shifts,
                })
            }
        };
        made.map_err(|error| refused(node, error.to_string()))
    }
}

/// What each output channel needs besides its weights.
#[derive(Default)]
struct Numbers {
    bias: Vec<i32>,
    multipliers: Vec<u8>,
    shifts: Vec<u8>,
}

impl Weighted {
    fn numbers(&self, node: &Node, step: f64) -> Result<Numbers, ConvertError> {
        let from = f64::from(self.input.exponent).exp2();
        let channels = self.scales.len();
        let patch = self.weights.len() / channels;
        let mut numbers = Numbers::default();
        for (channel, (&scale, &bias)) in self.scales.iter().zip(&self.bias).enumerate() {
            let (multiplier, shift) =
                fraction(f64::from(scale) * from / step).ok_or_else(|| {
                    let why =
                        format!("the weights' scale {scale} of channel {channel} is no m / 2^s");
                    refused(node, why)
                })?;
            let start = f64::from(bias) / (f64::from(scale) * from);
            if start.fract() != 0.0 || start.abs() > f64::from(i32::MAX) {
                let why =
                    format!("the bias {bias} of channel {channel} is no multiple of its step");
                return Err(refused(node, why));
            }
            let weight = |tap: usize| {
                i64::from(if self.depthwise {
                    self.weights[tap * channels + channel]
                } else {
                    self.weights[channel * patch + tap]
                })
            };
            let sum: i64 = (0..patch).map(weight).sum();
            let folded = start as i64 - i64::from(self.input.zero) * sum;
            // What is too large for a sum is noticed when the model is checked.
            let folded = folded.clamp(i32::MIN.into(), i32::MAX.into());
            numbers.bias.push(folded as i32);
            numbers.multipliers.push(multiplier);
            numbers.shifts.push(shift);
        }
        Ok(numbers)
    }
}
