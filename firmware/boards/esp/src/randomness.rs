//! Randomness before the radio runs, and for secrets while it does.

use core::convert::Infallible;

use esp_hal::peripherals::{ADC1, RNG};
use esp_hal::rng::{Rng, Trng, TrngSource};
use rand_core::{TryCryptoRng, TryRng};
use rand_pcg::Pcg32;

/// Sequence of the generator of control.
const CONTROL: u64 = 0x6374_726C;

/// A generator for the turns of behaviours, which differ from robot to robot and from boot to
/// boot.
///
/// The chip's own generator is as good as its noise: that of the radio while it runs, or that of
/// the converter while nobody else uses it. So the converter is borrowed for a seed, and given
/// back. The link, which starts after the radio, reads the chip's generator.
pub(crate) fn control(rng: RNG<'_>, adc: ADC1<'_>) -> Pcg32 {
    let source = TrngSource::new(rng, adc);
    let draw = || match Trng::try_new() {
        Ok(noise) => noise.random(),
        // Not while the source is there.
        Err(_) => Rng::new().random(),
    };
    let seed = u64::from(draw()) << 32 | u64::from(draw());
    drop(source);
    Pcg32::new(seed, CONTROL)
}

/// The chip's own generator while the radio runs: its noise makes what it draws true randomness
/// (ESP32-C3 Technical Reference Manual, chapter "Random Number Generator"; likewise of the others).
///
/// The link draws keys from it, and has a stream to draw them for only when the radio has joined.
pub(crate) struct Noise(Rng);

impl Noise {
    pub(crate) fn new() -> Self {
        Self(Rng::new())
    }
}

impl TryRng for Noise {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok(self.0.random())
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(u64::from(self.0.random()) << 32 | u64::from(self.0.random()))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        self.0.read(bytes);
        Ok(())
    }
}

impl TryCryptoRng for Noise {}
