//! The battery voltage behind its divider.

use crawler_hal::{Adc, Millivolts};

use crate::world::{Wire, normal};

/// Highest voltage the converter tells (ESP32-S3 at 12 dB: 3.1 V).
const CONVERTER_LIMIT_MV: f32 = 3_100.0;

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
        let gauge = space.parameters.gauge;
        let pin_mv = space.bodies.supply_v[ports.index()] * 1_000.0 * gauge.lower_ohm
            / (gauge.upper_ohm + gauge.lower_ohm);
        let noise_mv = normal(&mut *ports.gauge_rng.borrow_mut()) * gauge.noise_mv;
        let told = (pin_mv + noise_mv).clamp(0.0, CONVERTER_LIMIT_MV);
        Ok(Millivolts((told + 0.5) as u16))
    }
}
