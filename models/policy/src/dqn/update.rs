//! Gradients of half of the squared error of double DQN (van Hasselt, Guez and Silver 2016), piece by piece.

use super::memory::Memory;
use crate::batch::{PIECE, ROWS};
use crate::categorical;
use crate::compute::Compute;
use crate::network::{Network, Workspace};

/// A few samples of a minibatch, and the gradient that they come to.
#[derive(Debug)]
pub(super) struct Piece {
    pub(super) samples: Vec<u32>,
    pub(super) gradient: Vec<f32>,
    /// Sum of the losses, and of what was expected of the actions taken.
    pub(super) loss: f64,
    pub(super) value: f64,
}

impl Piece {
    pub(super) fn new(network: &Network) -> Self {
        Self {
            samples: Vec::with_capacity(PIECE),
            gradient: vec![0.0; network.parameters().len()],
            loss: 0.0,
            value: 0.0,
        }
    }
}

/// What a thread needs.
#[derive(Debug)]
pub(super) struct Scratch {
    inputs: Vec<f32>,
    space: Workspace,
    best: Vec<usize>,
    targets: Vec<f32>,
}

impl Scratch {
    pub(super) fn new(network: &Network) -> Self {
        Self {
            inputs: vec![0.0; ROWS * network.shape().inputs],
            space: Workspace::new(network, ROWS),
            best: vec![0; ROWS],
            targets: vec![0.0; ROWS],
        }
    }
}

/// What gradients are taken of.
pub(super) struct Objective<'a> {
    pub(super) compute: &'a Compute,
    pub(super) network: &'a Network,
    /// Where estimates are taken from.
    pub(super) target: &'a Network,
    pub(super) memory: &'a Memory,
    /// Samples in the minibatch.
    pub(super) minibatch: usize,
}

impl Objective<'_> {
    /// Computes gradient and sums of a piece.
    pub(super) fn differentiate(&self, scratch: &mut Scratch, piece: &mut Piece) {
        piece.gradient.fill(0.0);
        (piece.loss, piece.value) = (0.0, 0.0);
        for samples in piece.samples.chunks(ROWS) {
            self.estimate(scratch, samples);
            let width = self.network.shape().inputs;
            let inputs = scratch.inputs.chunks_exact_mut(width);
            for (sample, input) in samples.iter().zip(inputs) {
                input.copy_from_slice(self.memory.get(*sample as usize).observation);
            }
            let (rows, inputs) = (samples.len(), &scratch.inputs);
            self.network
                .forward(self.compute, rows, inputs, &mut scratch.space);
            let stride = self.network.output_stride();
            let (values, slopes) = scratch.space.outputs();
            let both = values
                .chunks_exact(stride)
                .zip(slopes.chunks_exact_mut(stride));
            for ((sample, target), (values, slopes)) in
                samples.iter().zip(&scratch.targets).zip(both)
            {
                let action = usize::from(self.memory.get(*sample as usize).action);
                let error = values[action] - target;
                slopes.fill(0.0);
                slopes[action] = error / self.minibatch as f32;
                piece.loss += 0.5 * f64::from(error) * f64::from(error);
                piece.value += f64::from(values[action]);
            }
            let space = &mut scratch.space;
            self.network
                .backward(self.compute, rows, inputs, space, &mut piece.gradient);
        }
    }

    /// What the values of the actions taken should have been. The network chooses the next action, and its older
    /// copy says what that one is worth.
    fn estimate(&self, scratch: &mut Scratch, samples: &[u32]) {
        let (shape, stride) = (self.network.shape(), self.network.output_stride());
        let inputs = scratch.inputs.chunks_exact_mut(shape.inputs);
        for (sample, input) in samples.iter().zip(inputs) {
            input.copy_from_slice(self.memory.get(*sample as usize).next);
        }
        let (rows, inputs) = (samples.len(), &scratch.inputs);
        self.network
            .forward(self.compute, rows, inputs, &mut scratch.space);
        let values = scratch.space.outputs().0.chunks_exact(stride);
        for (best, values) in scratch.best.iter_mut().zip(values) {
            *best = categorical::best(&values[..shape.outputs]);
        }
        self.target
            .forward(self.compute, rows, inputs, &mut scratch.space);
        let values = scratch.space.outputs().0.chunks_exact(stride);
        let chosen = scratch.targets.iter_mut().zip(&scratch.best).zip(values);
        for (sample, ((target, best), values)) in samples.iter().zip(chosen) {
            let transition = self.memory.get(*sample as usize);
            *target = transition.reward + transition.discount * values[*best];
        }
    }
}
