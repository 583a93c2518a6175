//! The sense activity: the ranger, and whether it can be believed.

mod filter;
#[cfg(test)]
mod tests;

use core::convert::Infallible;

use crawler_drivers::us100::{TemperatureError, Us100};
use crawler_hal::{Celsius, Clock, Duration, Instant, RangerPort, Ticker};
use crawler_protocol::Level;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{Read, Write};

use crate::context::Robot;

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
pub async fn sense<M, U, T, E, C>(
    robot: &Robot<M>,
    port: RangerPort<U, T, E>,
    clock: C,
) -> Infallible
where
    M: RawMutex,
    U: Read + Write,
    T: OutputPin,
    E: InputPin + Wait,
    C: Clock,
{
    let mut ranger = Us100::new(port);
    let mut ticker = Ticker::every(PERIOD, clock.now());
    let mut filter = RangeFilter::new(clock.now());
    let mut air = None;
    let mut thermometer_due = clock.now();
    loop {
        let measured = ranger.measure(&clock, air.unwrap_or(ROOM)).await;
        let now = clock.now();
        let moving = robot.snapshot().wheels.iter().any(|duty| *duty != 0.0);
        let before = filter.reading().health;
        let mut reading = filter.observe(measured, moving, now);
        reading.temperature = air;
        robot.reading.lock(|cell| cell.set(reading));
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
        // Only behind a good reading: a silent sensor would not tell its temperature either, and
        // waiting for it would only delay finding the sensor again.
        if measured.is_ok() && now >= thermometer_due {
            thermometer_due = now + TEMPERATURE_EVERY;
            match ranger.temperature(&clock).await {
                Ok(temperature) => air = Some(temperature),
                Err(TemperatureError::NotWired) => thermometer_due = Instant::FAR_FUTURE,
                Err(_) => air = None,
            }
        }
        ticker.tick(&clock).await;
    }
}
