//! The converter behind the battery's divider, whoever reads it.

use crawler_hal::Millivolts;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use crate::world::{Space, Spread, normal};

/// Highest voltage the converter tells (ESP32-S3 at 12 dB: 3.1 V).
const CONVERTER_LIMIT_MV: f32 = 3_100.0;

/// Draws of the build are cut at so many standard deviations.
const CUT: f32 = 3.0;

/// One divider and its converter.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Meter {
    rng: Pcg32,
    gain: f32,
    offset_mv: f32,
}

impl Meter {
    /// A converter with the peculiarities that `build` gives it; its readings draw from `rng`.
    pub(crate) fn new(rng: Pcg32, build: &mut Pcg32, spread: &Spread) -> Self {
        let mut draw = |deviation: f32| normal(build).clamp(-CUT, CUT) * deviation;
        Self {
            rng,
            gain: 1.0 + draw(spread.gauge_gain),
            offset_mv: draw(spread.gauge_offset_mv),
        }
    }

    /// One conversion.
    pub(crate) fn read(&mut self, space: &Space, robot: usize) -> Millivolts {
        let gauge = &space.parameters.gauge;
        let pin_mv = space.bodies.supply_v[robot] * 1_000.0 * gauge.lower_ohm
            / (gauge.upper_ohm + gauge.lower_ohm);
        let noise_mv = normal(&mut self.rng) * gauge.noise_mv;
        let felt = (pin_mv * self.gain + self.offset_mv + noise_mv).clamp(0.0, CONVERTER_LIMIT_MV);
        let told = libm::roundf(felt / gauge.step_mv) * gauge.step_mv;
        Millivolts((told + 0.5) as u16)
    }

    /// Whether a stored converter is one.
    pub(crate) fn is_sound(&self) -> bool {
        (0.0..=2.0).contains(&self.gain) && self.offset_mv.abs() <= 1_000.0
    }

    pub(crate) fn fingerprint(&self, mut word: impl FnMut(u64)) {
        use rand_core::Rng;
        word(self.rng.clone().next_u64());
        word(u64::from(self.gain.to_bits()));
        word(u64::from(self.offset_mv.to_bits()));
    }
}
