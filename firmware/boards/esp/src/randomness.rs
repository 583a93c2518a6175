//! Randomness from the chip.

use esp_hal::peripherals::{ADC1, RNG};
use esp_hal::rng::{Trng, TrngSource};

/// Draws a seed for whatever must differ from boot to boot before the radio runs.
///
/// The generator of the chip is as good as its noise: the radio while it runs, the converter while
/// nobody else uses it. So the converter is borrowed, and given back.
pub(crate) fn seed(rng: RNG<'_>, adc: ADC1<'_>) -> u64 {
    let source = TrngSource::new(rng, adc);
    let seed = Trng::try_new().map_or(0, |trng| {
        u64::from(trng.random()) << 32 | u64::from(trng.random())
    });
    drop(source);
    seed
}
