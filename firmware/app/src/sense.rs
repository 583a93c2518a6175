//! The sense activity: the ranger, and whether it can be believed.

mod filter;
#[cfg(test)]
mod tests;

use core::convert::Infallible;
use core::ops::Deref;

use crawler_drivers::us100::{RangeError, TemperatureError, Us100};
use crawler_hal::{Celsius, Clock, Duration, Instant, Millimeters, RangerPort, Ticker};
use crawler_protocol::Level;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{Read, Write};

use crate::context::{Robot, Snapshot};
use crate::perception::{Reading, SensorHealth};

pub use filter::RangeFilter;

/// Time between two measurements: the driver's own time-out of 65 ms and a rest, so that a late
/// echo of one does not answer the next.
pub const PERIOD: Duration = Duration::from_millis(80);
/// Time between two looks at the thermometer. Air does not change faster.
pub const TEMPERATURE_EVERY: Duration = Duration::from_secs(5);
/// Taken for the temperature of the air while nobody knows it.
const ROOM: Celsius = Celsius(20);

/// Measures every [`PERIOD`], filters, judges the sensor, and publishes.
///
/// An absent ranger costs the ranger: its state is published as dead, and it is asked again every
/// period until it answers.
///
/// # Cancellation Safety
/// As safe as the driver's: dropping it loses the measurement under way.
pub fn sense<M, U, T, E, C>(
    robot: impl Deref<Target = Robot<M>>,
    port: RangerPort<U, T, E>,
    clock: C,
) -> impl Future<Output = Infallible>
where
    M: RawMutex,
    U: Read + Write,
    T: OutputPin,
    E: InputPin + Wait,
    C: Clock,
{
    let mut ranger = Us100::new(port);
    async move {
        let mut ticker = Ticker::every(PERIOD, clock.now());
        let mut monitor = RangeMonitor::new(clock.now());
        loop {
            let measured = ranger.measure(&clock, monitor.air()).await;
            let now = clock.now();
            let measured = robot.injected.range(measured, now);
            let before = monitor.health();
            let Snapshot { wheels, pose, .. } = robot.snapshot();
            let reading = monitor.observe(measured, wheels, pose.theta, now);
            robot.sense_handle().publish(&reading);
            if reading.health != before {
                let level = if reading.health.is_fault() {
                    Level::Error
                } else {
                    Level::Info
                };
                robot.log(
                    level,
                    "ranger",
                    format_args!("{}", reading.health.name()),
                    now,
                );
            }
            if monitor.wants_temperature(measured, now) {
                monitor.set_air_temperature(ranger.temperature(&clock).await);
            }
            ticker.tick(&clock).await;
        }
    }
}

/// What the activity keeps between two measurements, without the ranger. A value, so that it runs
/// without waiting.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeMonitor {
    filter: RangeFilter,
    air: Option<Celsius>,
    thermometer_due: Instant,
}

impl RangeMonitor {
    /// A monitor that has seen nothing. The sensor has from `now` on to answer.
    pub const fn new(now: Instant) -> Self {
        Self {
            filter: RangeFilter::new(now),
            air: None,
            thermometer_due: now,
        }
    }

    /// The temperature of the air, as far as it is known.
    pub fn air(&self) -> Celsius {
        self.air.unwrap_or(ROOM)
    }

    /// What is thought of the sensor.
    pub const fn health(&self) -> SensorHealth {
        self.filter.reading().health
    }

    /// Takes one measurement in. `wheels` are the duties of the wheels, and `heading` is where the robot
    /// looks, in radians of odometry.
    pub fn observe(
        &mut self,
        measured: Result<Millimeters, RangeError>,
        wheels: [f32; 2],
        heading: f32,
        now: Instant,
    ) -> Reading {
        let moving = wheels.iter().any(|duty| *duty != 0.0);
        Reading {
            temperature: self.air,
            ..self.filter.observe(measured, moving, heading, now)
        }
    }

    /// Whether to ask for the temperature behind this measurement. The question then counts as
    /// asked.
    ///
    /// Only behind a good reading: a silent sensor would not tell its temperature either, and
    /// waiting for it would only delay finding the sensor again.
    pub fn wants_temperature(
        &mut self,
        measured: Result<Millimeters, RangeError>,
        now: Instant,
    ) -> bool {
        let due = measured.is_ok() && now >= self.thermometer_due;
        if due {
            self.thermometer_due = now + TEMPERATURE_EVERY;
        }
        due
    }

    /// Takes in what the thermometer said.
    pub fn set_air_temperature(&mut self, temperature: Result<Celsius, TemperatureError>) {
        match temperature {
            Ok(temperature) => self.air = Some(temperature),
            Err(TemperatureError::NotWired) => self.thermometer_due = Instant::FAR_FUTURE,
            Err(_) => self.air = None,
        }
    }
}
