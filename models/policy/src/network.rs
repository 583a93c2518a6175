//! A multilayer perceptron: forward, and backward.
//!
//! Rows of samples go through it together, as many as the [`Workspace`] is for. A row comes out the same
//! whatever rows stand beside it. Gradients are sums over rows, in their order.

mod initial;
#[cfg(test)]
mod tests;

use std::ops::Range;

use crate::compute::Compute;
use crate::kernel::{Product, padded};
use crate::math::tanh;

/// What stands between two layers. Outputs are linear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// The hyperbolic tangent.
    Tanh,
    /// The positive part.
    Relu,
}

/// How large a network is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shape {
    /// Numbers that go in.
    pub inputs: usize,
    /// Units of each hidden layer, from the inputs on.
    pub hidden: Vec<usize>,
    /// Numbers that come out.
    pub outputs: usize,
    /// After each hidden layer.
    pub activation: Activation,
}

/// One layer, in the parameters of a network: weights input by input, each row as long as `stride`; then the
/// biases. What fills the rows up is zero, and stays so: its gradient is zero.
#[derive(Debug, Clone)]
struct Layer {
    inputs: usize,
    outputs: usize,
    stride: usize,
    weights: Range<usize>,
    biases: Range<usize>,
    /// Where its weights lie output by output, for the way back. The first layer has none.
    turned: Range<usize>,
}

impl Layer {
    /// Length of a row of `turned`.
    const fn turned_stride(&self) -> usize {
        padded(self.inputs)
    }
}

/// One layer of a network, to read.
#[derive(Debug, Clone, Copy)]
pub struct Weights<'a> {
    /// Numbers that it looks at.
    pub inputs: usize,
    /// Numbers that it has.
    pub outputs: usize,
    stride: usize,
    matrix: &'a [f32],
    biases: &'a [f32],
}

impl Weights<'_> {
    /// With what `input` is multiplied for `output`.
    pub fn weight(&self, input: usize, output: usize) -> f32 {
        self.matrix[input * self.stride + output]
    }

    /// What is added to `output`.
    pub fn bias(&self, output: usize) -> f32 {
        self.biases[output]
    }
}

/// A multilayer perceptron.
#[derive(Debug, Clone)]
pub struct Network {
    shape: Shape,
    layers: Vec<Layer>,
    parameters: Vec<f32>,
    turned: Vec<f32>,
}

/// Room for what `rows` samples come to in every layer.
#[derive(Debug)]
pub(crate) struct Workspace {
    rows: usize,
    /// What each layer hands on.
    values: Vec<Vec<f32>>,
    /// The gradient of the loss by each of these.
    slopes: Vec<Vec<f32>>,
}

impl Workspace {
    /// For this network and up to `rows` samples at once.
    pub(crate) fn new(network: &Network, rows: usize) -> Self {
        let room = || network.layers.iter().map(|l| vec![0.0; rows * l.stride]);
        Self {
            rows,
            values: room().collect(),
            slopes: room().collect(),
        }
    }

    /// The outputs of the last forward pass, and the place for the gradient of the loss by them, each row
    /// filled up to [`Network::output_stride`].
    pub(crate) fn outputs(&mut self) -> (&mut [f32], &mut [f32]) {
        let (values, slopes) = (self.values.last_mut(), self.slopes.last_mut());
        // A network has at least one layer.
        (
            values.map_or(&mut [], |v| v.as_mut_slice()),
            slopes.map_or(&mut [], |s| s.as_mut_slice()),
        )
    }
}

impl Network {
    /// A network whose parameters are all zero.
    pub fn zero(shape: Shape) -> Self {
        let sizes: Vec<usize> = [shape.inputs]
            .into_iter()
            .chain(shape.hidden.iter().copied())
            .chain([shape.outputs])
            .collect();
        let (mut at, mut turned) = (0, 0);
        let mut layers: Vec<Layer> = Vec::new();
        for pair in sizes.windows(2) {
            let (inputs, outputs) = (pair[0], pair[1]);
            let stride = padded(outputs);
            let weights = at..at + inputs * stride;
            let biases = weights.end..weights.end + stride;
            let turned_end = turned
                + if layers.is_empty() {
                    0
                } else {
                    outputs * padded(inputs)
                };
            at = biases.end;
            layers.push(Layer {
                inputs,
                outputs,
                stride,
                weights,
                biases,
                turned: turned..turned_end,
            });
            turned = turned_end;
        }
        Self {
            shape,
            layers,
            parameters: vec![0.0; at],
            turned: vec![0.0; turned],
        }
    }

    /// Its layers, from the inputs on.
    pub fn layers(&self) -> impl Iterator<Item = Weights<'_>> {
        self.layers.iter().map(|layer| Weights {
            inputs: layer.inputs,
            outputs: layer.outputs,
            stride: layer.stride,
            matrix: &self.parameters[layer.weights.clone()],
            biases: &self.parameters[layer.biases.clone()],
        })
    }

    /// Its shape.
    pub const fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Weights and biases, layer by layer, with what fills rows up.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// How many weights and biases it has.
    pub fn size(&self) -> usize {
        let layers = self.layers.iter();
        layers.map(|layer| (layer.inputs + 1) * layer.outputs).sum()
    }

    /// Appends weights and biases, layer by layer, input by input, without what fills rows up.
    pub(crate) fn pack(&self, out: &mut Vec<f32>) {
        for layer in &self.layers {
            let all = layer.weights.start..layer.biases.end;
            for row in self.parameters[all].chunks_exact(layer.stride) {
                out.extend_from_slice(&row[..layer.outputs]);
            }
        }
    }

    /// Takes what [`pack`](Self::pack) wrote.
    ///
    /// # Panics
    /// When `packed` is not of this [`size`](Self::size).
    pub(crate) fn unpack(&mut self, packed: &[f32]) {
        assert_eq!(packed.len(), self.size(), "weights of this network");
        let layers = self.layers.clone();
        self.change(|parameters| {
            let mut rest = packed;
            for layer in &layers {
                let all = layer.weights.start..layer.biases.end;
                for row in parameters[all].chunks_exact_mut(layer.stride) {
                    let (own, after) = rest.split_at(layer.outputs);
                    row[..layer.outputs].copy_from_slice(own);
                    rest = after;
                }
            }
        });
    }

    /// Length of a row of outputs.
    pub(crate) const fn output_stride(&self) -> usize {
        padded(self.shape.outputs)
    }

    /// Changes the parameters.
    pub(crate) fn change<R>(&mut self, change: impl FnOnce(&mut [f32]) -> R) -> R {
        let result = change(&mut self.parameters);
        for layer in self.layers.iter().skip(1) {
            let weights = &self.parameters[layer.weights.clone()];
            let turned = &mut self.turned[layer.turned.clone()];
            for (output, row) in turned.chunks_exact_mut(layer.turned_stride()).enumerate() {
                for (input, weight) in row[..layer.inputs].iter_mut().enumerate() {
                    *weight = weights[input * layer.stride + output];
                }
            }
        }
        result
    }

    /// Computes the outputs of `rows` samples, which lie one after the other in `inputs`, into the workspace.
    ///
    /// # Panics
    /// When the workspace is for another network or fewer rows, or `inputs` are too few.
    pub(crate) fn forward(
        &self,
        compute: &Compute,
        rows: usize,
        inputs: &[f32],
        space: &mut Workspace,
    ) {
        assert!(rows <= space.rows, "room for {} rows", space.rows);
        let last = self.layers.len() - 1;
        for (index, layer) in self.layers.iter().enumerate() {
            let (before, values) = space.values.split_at_mut(index);
            let out = &mut values[0][..rows * layer.stride];
            for row in out.chunks_exact_mut(layer.stride) {
                row.copy_from_slice(&self.parameters[layer.biases.clone()]);
            }
            let (left, stride) = match index {
                0 => (inputs, layer.inputs),
                _ => (before[index - 1].as_slice(), self.layers[index - 1].stride),
            };
            compute.run(Product::<false> {
                rows,
                depth: layer.inputs,
                columns: layer.stride,
                left,
                stride,
                right: &self.parameters[layer.weights.clone()],
                out,
            });
            if index < last {
                activate(compute, self.shape.activation, out);
            }
        }
    }

    /// Adds the gradient of a loss by the parameters to `gradient`, for the samples of the last forward pass.
    /// The gradient by the outputs is where [`Workspace::outputs`] has its place, and zero where rows are
    /// filled up.
    ///
    /// # Panics
    /// As [`forward`](Self::forward), and when `gradient` is shorter than the parameters.
    pub(crate) fn backward(
        &self,
        compute: &Compute,
        rows: usize,
        inputs: &[f32],
        space: &mut Workspace,
        gradient: &mut [f32],
    ) {
        for (index, layer) in self.layers.iter().enumerate().rev() {
            let (before, slopes) = space.slopes.split_at_mut(index);
            let slope = &slopes[0][..rows * layer.stride];
            let (left, stride) = match index {
                0 => (inputs, layer.inputs),
                _ => (
                    space.values[index - 1].as_slice(),
                    self.layers[index - 1].stride,
                ),
            };
            compute.run(Product::<true> {
                rows: layer.inputs,
                depth: rows,
                columns: layer.stride,
                left,
                stride,
                right: slope,
                out: &mut gradient[layer.weights.clone()],
            });
            let biases = &mut gradient[layer.biases.clone()];
            for row in slope.chunks_exact(layer.stride) {
                for (sum, slope) in biases.iter_mut().zip(row) {
                    *sum += slope;
                }
            }
            if index == 0 {
                break;
            }
            let width = self.layers[index - 1].stride;
            let out = &mut before[index - 1][..rows * width];
            out.fill(0.0);
            compute.run(Product::<false> {
                rows,
                depth: layer.outputs,
                columns: width,
                left: slope,
                stride: layer.stride,
                right: &self.turned[layer.turned.clone()],
                out,
            });
            deactivate(
                compute,
                self.shape.activation,
                &space.values[index - 1],
                out,
            );
        }
    }
}

/// Applies the activation.
fn activate(compute: &Compute, activation: Activation, values: &mut [f32]) {
    match activation {
        Activation::Tanh => compute.run(
            #[inline(always)]
            || values.iter_mut().for_each(|value| *value = tanh(*value)),
        ),
        Activation::Relu => compute.run(
            #[inline(always)]
            || values.iter_mut().for_each(|value| *value = value.max(0.0)),
        ),
    }
}

/// Takes slopes back through the activation that made `values`.
fn deactivate(compute: &Compute, activation: Activation, values: &[f32], slopes: &mut [f32]) {
    let pairs = slopes.iter_mut().zip(values);
    match activation {
        Activation::Tanh => compute.run(
            #[inline(always)]
            || pairs.for_each(|(slope, value)| *slope *= 1.0 - value * value),
        ),
        Activation::Relu => compute.run(
            #[inline(always)]
            || {
                pairs.for_each(|(slope, value)| {
                    *slope = if *value > 0.0 { *slope } else { 0.0 };
                });
            },
        ),
    }
}
