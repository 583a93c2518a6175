//! Many samples through a network, a few rows at a time.

use crate::compute::Compute;
use crate::network::{Network, Workspace};

/// Rows that go through a network together: what they come to fits into the caches next to the processor.
pub(crate) const ROWS: usize = 64;

/// Samples whose gradients are one sum. A minibatch is cut into pieces of this size, whatever the threads.
pub(crate) const PIECE: usize = 256;

/// Room to run a network on any number of rows.
#[derive(Debug)]
pub(crate) struct Runner {
    pub(crate) inputs: Vec<f32>,
    pub(crate) outputs: Vec<f32>,
    space: Workspace,
}

impl Runner {
    pub(crate) fn new(network: &Network) -> Self {
        Self {
            inputs: Vec::new(),
            outputs: Vec::new(),
            space: Workspace::new(network, ROWS),
        }
    }

    /// Makes room for the inputs of `rows` rows.
    pub(crate) fn reserve(&mut self, network: &Network, rows: usize) {
        self.inputs.resize(rows * network.shape().inputs, 0.0);
    }

    /// Computes the outputs of all rows of `inputs`, one row after the other.
    pub(crate) fn run(&mut self, network: &Network, compute: &Compute) {
        let shape = network.shape();
        let stride = network.output_stride();
        self.outputs.clear();
        for inputs in self.inputs.chunks(ROWS * shape.inputs) {
            let rows = inputs.len() / shape.inputs;
            network.forward(compute, rows, inputs, &mut self.space);
            let (outputs, _) = self.space.outputs();
            for row in outputs[..rows * stride].chunks_exact(stride) {
                self.outputs.extend_from_slice(&row[..shape.outputs]);
            }
        }
    }
}
