//! The power activity: the battery gauge.

#[cfg(test)]
mod tests;

use core::convert::Infallible;
use core::ops::Deref;

use crawler_drivers::battery::{self, Config, Divider, Gauge, Thresholds};
use crawler_hal::{Adc, Clock, Duration, Millivolts, Ticker, with_deadline};
use crawler_protocol::Level;
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::context::Robot;
use crate::parameters::{BATTERY_HYSTERESIS_MV, Parameter, Parameters};
use crate::perception::{Battery, Charge};

/// Time between two measurements: what the gauge's filter is made for.
pub const PERIOD: Duration = Duration::from_millis(1_000);
/// Below this the flash is not written. At 3.0 V a cell the regulator of the board has no headroom
/// left, and the next start of a motor may take the supply away in the middle of a write.
pub const FLASH_MINIMUM: Millivolts = Millivolts(6_000);
/// A conversion takes microseconds; a converter that needs longer than this is broken.
const CONVERSION: Duration = Duration::from_millis(100);

/// Reads the battery every [`PERIOD`] and publishes what follows from it.
///
/// A converter that fails or hangs costs the gauge, and makes the robot drive slowly.
///
/// # Cancellation Safety
/// Dropping it loses one measurement.
// Not an `async fn`, which would keep its arguments twice: as they came and as they are used.
#[allow(clippy::manual_async_fn)]
pub fn power<M: RawMutex, A: Adc, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    mut adc: A,
    clock: C,
) -> impl Future<Output = Infallible> {
    async move {
        let mut ticker = Ticker::every(PERIOD, clock.now());
        let mut monitor = robot.with_parameters(Monitor::new);
        let mut version = robot.with_parameters(Parameters::version);
        loop {
            let measured = with_deadline(&clock, clock.now() + CONVERSION, adc.read()).await;
            let pin = match measured {
                Ok(Ok(pin)) => Some(pin),
                Ok(Err(_)) | Err(_) => None,
            };
            let newest = robot.with_parameters(Parameters::version);
            if newest != version {
                version = newest;
                robot.with_parameters(|parameters| monitor.adjust(parameters));
            }
            let before = monitor.battery();
            let battery = monitor.observe(pin);
            robot.power_handle().publish(battery);
            if battery.charge != before.charge {
                let level = match battery.charge {
                    Charge::Unknown | Charge::Good => Level::Info,
                    Charge::Low => Level::Warn,
                    Charge::Critical => Level::Error,
                };
                let mv = battery.voltage.map_or(0, |voltage| voltage.0);
                let text = format_args!("{} at {mv} mV", battery.charge.name());
                robot.log(level, "battery", text, clock.now());
            }
            ticker.tick(&clock).await;
        }
    }
}

/// The gauge with the limits of the parameters. A value, so that it is tested without waiting.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Monitor {
    gauge: Gauge,
    #[cfg_attr(feature = "serde", serde(skip, default = "standard_divider"))]
    divider: Divider,
    battery: Battery,
}

impl Monitor {
    /// A monitor that has measured nothing.
    pub fn new(parameters: &Parameters) -> Self {
        let config = config(parameters);
        Self {
            gauge: Gauge::new(config),
            divider: config.divider,
            battery: Battery::default(),
        }
    }

    /// Takes other limits. What was measured stays: a critical pack does not recover because
    /// somebody sets a parameter.
    pub fn adjust(&mut self, parameters: &Parameters) {
        self.gauge.set_thresholds(config(parameters).thresholds);
    }

    /// What was found last.
    pub const fn battery(&self) -> Battery {
        self.battery
    }

    /// Takes in the voltage at the pin, or that there is none.
    pub fn observe(&mut self, pin: Option<Millivolts>) -> Battery {
        let reading = match pin {
            Some(pin) => self.gauge.update(pin),
            None => self.gauge.missed(),
        };
        let (charge, known) = match reading.charge {
            battery::Charge::Ok => (Charge::Good, true),
            battery::Charge::Low => (Charge::Low, true),
            battery::Charge::Critical => (Charge::Critical, true),
            // On its USB plug a robot has no motor supply to look after.
            battery::Charge::Absent => (Charge::Unknown, false),
            // Nothing can be said, so the robot is driven with care.
            _ => (Charge::Low, false),
        };
        // The flash minds the lowest instant and not the mean.
        let lowest = pin.map(|pin| self.divider.pack(pin).min(reading.pack));
        let brown_out = reading.charge != battery::Charge::Absent
            && lowest.is_some_and(|pack| pack < FLASH_MINIMUM);
        self.battery = Battery {
            voltage: known.then_some(reading.pack),
            percent: known.then_some(reading.percent),
            charge,
            brown_out,
        };
        self.battery
    }
}

#[cfg(feature = "serde")]
fn standard_divider() -> Divider {
    Config::STANDARD.divider
}

fn config(parameters: &Parameters) -> Config {
    let mv = |parameter| Millivolts(parameters.number(parameter) as u16);
    // The table and its cross-check keep the limits in order; if they ever did not, the usual
    // ones would be the safe choice.
    let thresholds = Thresholds::new(
        mv(Parameter::LowBattery),
        mv(Parameter::CriticalBattery),
        Millivolts(BATTERY_HYSTERESIS_MV as u16),
    )
    .unwrap_or(Config::STANDARD.thresholds);
    Config {
        thresholds,
        ..Config::STANDARD
    }
}
