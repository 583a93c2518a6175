//! The sense activity: the ranger, and whether it can be believed.

mod filter;
mod jitter;
mod pilot;
#[cfg(test)]
mod tests;

use core::convert::Infallible;
use core::ops::Deref;

use crawler_drivers::us100::{RangeError, TemperatureError, Us100};
use crawler_hal::{Celsius, Clock, Duration, Instant, Millimeters, RangerPort, Ticker};
use crawler_protocol::Level;
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{Read, Write};

use crate::behaviour::Leeway;
use crate::context::{Robot, Snapshot};
use crate::hold::{Hold, Inline};
use crate::navigation::{Navigator, Planned};
use crate::neighbours::name_of;
use crate::perception::{Reading, SensorHealth};

pub use filter::RangeFilter;
pub use jitter::Jitter;
use pilot::{Pilot, course_of, look_of};

/// Time between two measurements, but for a [`Jitter`]: the driver's own time-out of 65 ms and a rest, so that a late
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
/// While the robot is on its way to a place, it also keeps the map and plans, in slices between which others run:
/// see [`navigation`](crate::navigation). Of both it copies what the link wants to tell.
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
    sense_held::<Inline, _, _, _, _, _>(robot, port, clock)
}

/// As [`sense`], which keeps map and plan the way of `H` while they are not needed.
pub fn sense_held<H, M, U, T, E, C>(
    robot: impl Deref<Target = Robot<M>>,
    port: RangerPort<U, T, E>,
    clock: C,
) -> impl Future<Output = Infallible>
where
    H: Hold,
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
        let mut pilot = Pilot::<H::Room<Navigator>>::new();
        let mut jitter = Jitter::new(name_of(&robot.config().id));
        loop {
            let looked_from = robot.snapshot().pose;
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
            if let Some(going) = robot.going() {
                let look = look_of(measured).filter(|_| monitor.is_believed());
                robot
                    .sense_handle()
                    .keep_off(&course_of(&robot.snapshot(), going), now);
                yield_now().await;
                let others = robot.sense_handle().others(now);
                pilot.look(&looked_from, going, look, &others);
                loop {
                    yield_now().await;
                    if let Planned::Guide(guide) = pilot.plan() {
                        robot.sense_handle().guide_to(guide);
                        break;
                    }
                }
            } else {
                robot.sense_handle().keep_to(Leeway::ALL);
                pilot.rest();
            }
            robot.sense_handle().report_map(pilot.navigator(), now);
            ticker.tick_late(&clock, jitter.draw()).await;
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

    /// Whether the newest measurement is one for the map: of a sensor in good health, and
    /// [confirmed](RangeFilter::is_confirmed).
    pub fn is_believed(&self) -> bool {
        self.health() == SensorHealth::Good && self.filter.is_confirmed()
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
