//! The battery voltage: ADC1 behind the divider, calibrated by what the factory burnt into the
//! chip.

use crawler_drivers::battery::{Config, Divider};
use crawler_hal::{Adc as Converter, Millivolts};
use esp_hal::Blocking;
use esp_hal::analog::adc::{Adc, AdcCalCurve, AdcConfig, AdcPin, Attenuation};
use esp_hal::peripherals::ADC1;

use crate::board::{self, BatteryPin};

/// Conversions averaged into a reading: their noise is some ten millivolts.
const SAMPLES: u16 = 16;
/// Looks at the converter until a conversion counts as failed. One takes some ten microseconds,
/// a look much less than one.
const PATIENCE: u32 = 10_000;

/// Why there is no voltage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub(crate) enum BatteryError {
    /// The converter did not finish: it is not set up, or broken.
    Stuck,
    /// The pin has more than the converter can tell: the divider is wrong, or not there.
    Beyond,
}

/// The divider the program's gauge takes for granted.
const STANDARD: Divider = Config::STANDARD.divider;

/// The battery's converter.
///
/// It tells the voltage that the divider of the usual robot would have: a board whose converter
/// ends earlier has another divider, which is a matter of the board alone.
pub(crate) struct Battery {
    adc: Adc<'static, ADC1<'static>, Blocking>,
    pin: AdcPin<BatteryPin, ADC1<'static>, AdcCalCurve<ADC1<'static>>>,
}

impl Battery {
    /// The converter with the attenuation for the widest range.
    pub(crate) fn new(adc: ADC1<'static>, pin: BatteryPin) -> Self {
        let mut config = AdcConfig::new();
        let pin = config.enable_pin_with_cal(pin, Attenuation::_11dB);
        Self {
            adc: Adc::new(adc, config),
            pin,
        }
    }

    fn sample(&mut self) -> Result<u16, BatteryError> {
        for _ in 0..PATIENCE {
            match self.adc.read_oneshot(&mut self.pin) {
                // The correction of a tiny value may pass zero, and then wraps.
                Ok(mv) if mv > u16::MAX / 2 => return Ok(0),
                Ok(mv) => return Ok(mv),
                Err(_) => core::hint::spin_loop(),
            }
        }
        Err(BatteryError::Stuck)
    }
}

impl Converter for Battery {
    type Error = BatteryError;

    async fn read(&mut self) -> Result<Millivolts, BatteryError> {
        let mut sum = 0_u32;
        for _ in 0..SAMPLES {
            sum += u32::from(self.sample()?);
        }
        let pin = (sum / u32::from(SAMPLES)) as u16;
        if pin > board::CONVERTER_LIMIT_MV {
            return Err(BatteryError::Beyond);
        }
        Ok(STANDARD.pin(board::DIVIDER.pack(Millivolts(pin))))
    }
}
