//! The battery voltage behind its divider.

use crawler_hal::{Adc, Millivolts};

use super::ports::Wire;

/// An analogue input on the middle of the battery's divider.
#[derive(Debug)]
pub struct SimGauge {
    wire: Wire,
}

/// The body behind this input was reset or lost its power.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GaugeError;

impl SimGauge {
    pub(crate) const fn new(wire: Wire) -> Self {
        Self { wire }
    }
}

impl Adc for SimGauge {
    type Error = GaugeError;

    async fn read(&mut self) -> Result<Millivolts, GaugeError> {
        if !self.wire.is_live() {
            return Err(GaugeError);
        }
        let ports = &self.wire.ports;
        let space = ports.shared.space.borrow();
        Ok(ports.meter.borrow_mut().read(&space, ports.index()))
    }
}
