//! A network that is learned, with what its optimiser keeps.

use crate::adam::Adam;
use crate::checkpoint::{CheckpointError, Reader, Writer};
use crate::network::Network;

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct Learner {
    pub(crate) network: Network,
    adam: Adam,
}

impl Learner {
    pub(crate) fn new(network: Network) -> Self {
        let adam = Adam::new(network.parameters().len());
        Self { network, adam }
    }

    /// One step down `scale · gradient`.
    pub(crate) fn step(&mut self, gradient: &[f32], scale: f32, rate: f64) {
        let adam = &mut self.adam;
        self.network
            .change(|parameters| adam.step(parameters, gradient, scale, rate));
    }

    pub(crate) fn write(&self, writer: &mut Writer) {
        writer.f32s(self.network.parameters());
        let [means, squares] = &self.adam.moments;
        writer.f32s(means);
        writer.f32s(squares);
        writer.u64(self.adam.steps);
    }

    pub(crate) fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CheckpointError> {
        self.network
            .change(|parameters| reader.f32s(parameters, "weights"))?;
        let [means, squares] = &mut self.adam.moments;
        reader.f32s(means, "moments")?;
        reader.f32s(squares, "moments")?;
        if squares.iter().any(|square| *square < 0.0) {
            return Err(CheckpointError::Invalid("moments"));
        }
        self.adam.steps = reader.count()?;
        Ok(())
    }
}
