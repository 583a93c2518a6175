//! US-100 ultrasonic ranger.
//!
//! Its jumper decides how it talks ([`RangerPort`]):
//!
//! - **UART** (jumper set): 9600 baud, 8N1. `0x55` asks for the range, two bytes, high byte first,
//!   in millimetres, already corrected for temperature. `0x50` asks for the temperature, one byte,
//!   degrees Celsius plus 45.
//! - **Pulse** (jumper open): at least 10 µs high on Trig start a measurement, and Echo goes high
//!   for as long as the sound travels. The caller hands in the temperature of the air.
//!
//! Frames have neither header nor checksum. What stands in for them: the input is drained before
//! each request, so a late reply cannot answer a new one; the reply has to come in time, in full,
//! and be followed by silence; and it has to lie within the reach of the sensor.

use core::fmt;

use crawler_hal::{Celsius, Clock, Duration, Millimeters, RangerPort};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorKind, Read, Write};

mod pulse;
mod uart;

#[cfg(test)]
mod tests;

pub use pulse::{echo_range, echo_width, speed_of_sound_mm_per_s};

/// Nearest the sensor can tell: 2 cm (data sheet). Its own ringing hides what is nearer.
pub const NEAREST: Millimeters = Millimeters(20);
/// Farthest the sensor can tell: 4.5 m (data sheet).
pub const FARTHEST: Millimeters = Millimeters(4_500);
/// Coldest the sensor works at: −20 °C (data sheet).
pub const COLDEST: Celsius = Celsius(-20);
/// Warmest the sensor works at: 70 °C (data sheet).
pub const WARMEST: Celsius = Celsius(70);

/// The temperature at which sound travels at 340 m/s, to 0.1 %.
pub const CORRECTED: Celsius = Celsius(14);

/// How long a measurement may take. Echo from 4.5 m at 319 m/s (−20 °C): 28.2 ms. Three bytes at
/// 9600 baud, ten bits each: 3.1 ms. Together 31.3 ms, doubled, because the sensor's own latency
/// is not specified.
pub const REPLY_TIMEOUT: Duration = Duration::from_millis(63);
/// How long the line has to be silent after a reply: two bytes at 9600 baud, ten bits each, so
/// that a third byte sent right behind the reply is seen.
pub const SILENCE: Duration = Duration::from_micros(2_084);
/// Length of the trigger pulse; the data sheet wants at least 10 µs.
pub const TRIGGER: Duration = Duration::from_micros(10);

/// What went wrong between the controller and the sensor. Each variant calls for a different next
/// step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LinkError {
    /// Nothing, or not all, came in time: cable, power or jumper. Retry, then report the sensor
    /// lost.
    Timeout,
    /// More came than was asked for: another baud rate, interference, or something else on the
    /// line. What was read may be anything, so it was dropped. Retry, then look at the line.
    Noise,
    /// The UART itself reports an error: retry, then look at its set-up.
    Uart(ErrorKind),
    /// The UART is closed, which no retry can change.
    Closed,
    /// The trigger or echo pin refuses, which no retry can change.
    Pin,
    /// Echo is high and does not fall: a measurement that found nothing is still running, or the
    /// pin is shorted. Retry, then report the sensor lost.
    EchoStuck,
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Timeout => f.write_str("no complete reply in time"),
            Self::Noise => f.write_str("more bytes than asked for"),
            Self::Uart(kind) => write!(f, "uart: {kind}"),
            Self::Closed => f.write_str("uart is closed"),
            Self::Pin => f.write_str("trigger or echo pin refuses"),
            Self::EchoStuck => f.write_str("echo stays high"),
        }
    }
}

impl core::error::Error for LinkError {}

/// Why there is no range. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RangeError {
    /// No usable reply.
    Link(LinkError),
    /// Below [`NEAREST`]: something touches the robot. Stop.
    TooNear(Millimeters),
    /// Beyond [`FARTHEST`]: nothing in reach, or a slanted or soft surface.
    NoEcho(Millimeters),
}

impl fmt::Display for RangeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Link(error) => write!(f, "ranger: {error}"),
            Self::TooNear(range) => write!(f, "ranger: {} mm is too near to tell", range.0),
            Self::NoEcho(range) => write!(f, "ranger: no echo within reach ({} mm)", range.0),
        }
    }
}

impl core::error::Error for RangeError {}

impl From<LinkError> for RangeError {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

/// Why there is no temperature. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TemperatureError {
    /// No usable reply.
    Link(LinkError),
    /// Outside [`COLDEST`] to [`WARMEST`], where the sensor does not work: trust neither this nor
    /// its ranges.
    Absurd(Celsius),
    /// In pulse mode the sensor tells no temperature: use another source, and do not ask again.
    NotWired,
}

impl fmt::Display for TemperatureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Link(error) => write!(f, "ranger temperature: {error}"),
            Self::Absurd(air) => write!(f, "ranger temperature: {} °C is absurd", air.0),
            Self::NotWired => f.write_str("ranger temperature: not told in pulse mode"),
        }
    }
}

impl core::error::Error for TemperatureError {}

impl From<LinkError> for TemperatureError {
    fn from(error: LinkError) -> Self {
        Self::Link(error)
    }
}

/// A US-100.
#[derive(Debug)]
pub struct Us100<U, T, E> {
    port: RangerPort<U, T, E>,
}

impl<U, T, E> Us100<U, T, E> {
    /// A driver for the sensor at `port`. Does no I/O, so an absent sensor cannot stop the boot.
    pub const fn new(port: RangerPort<U, T, E>) -> Self {
        Self { port }
    }

    /// Whether the sensor tells its temperature: it does over its UART.
    pub const fn tells_temperature(&self) -> bool {
        match self.port {
            RangerPort::Uart(_) => true,
            RangerPort::Pulse { .. } => false,
        }
    }

    /// Gives the port back.
    pub fn release(self) -> RangerPort<U, T, E> {
        self.port
    }
}

impl<U: Read + Write, T: OutputPin, E: InputPin + Wait> Us100<U, T, E> {
    /// Measures the distance to the nearest surface.
    ///
    /// `air` is the temperature of the air, for pulse mode; over the UART the sensor corrects by
    /// itself, and `air` is not used. Being 10 °C wrong costs 2 % of the range. (A module that
    /// corrects the width of its echo too, for 340 m/s, wants [`CORRECTED`] instead.)
    ///
    /// In pulse mode the width of the echo is the time between two wake-ups of this task: an
    /// executor that is 100 µs late at one of them is 17 mm off.
    ///
    /// # Errors
    /// See [`RangeError`]. Returns within [`REPLY_TIMEOUT`] + [`SILENCE`] in every case.
    ///
    /// # Cancellation Safety
    /// A dropped call may leave a reply under way or the trigger high; the next call drops the
    /// former, unless it arrives after that call began, and ends the latter.
    pub async fn measure<C: Clock>(
        &mut self,
        clock: &C,
        air: Celsius,
    ) -> Result<Millimeters, RangeError> {
        match &mut self.port {
            RangerPort::Uart(uart) => {
                let reply = uart::request(uart, clock, uart::RANGE).await?;
                parse_range(reply)
            }
            RangerPort::Pulse { trigger, echo } => {
                let width = pulse::measure(trigger, echo, clock).await?;
                check_range(echo_range(width, air))
            }
        }
    }

    /// Asks the sensor for its temperature, which is that of the air around it.
    ///
    /// # Errors
    /// See [`TemperatureError`]. Returns within [`REPLY_TIMEOUT`] + [`SILENCE`] in every case.
    ///
    /// # Cancellation Safety
    /// As [`Self::measure`].
    pub async fn temperature<C: Clock>(&mut self, clock: &C) -> Result<Celsius, TemperatureError> {
        match &mut self.port {
            RangerPort::Uart(uart) => {
                let reply = uart::request(uart, clock, uart::TEMPERATURE).await?;
                parse_temperature(reply)
            }
            RangerPort::Pulse { .. } => Err(TemperatureError::NotWired),
        }
    }
}

/// Decodes a range reply, high byte first. The frame has no checksum, so the reach of the sensor
/// is the only test of plausibility.
///
/// # Errors
/// [`RangeError::TooNear`] or [`RangeError::NoEcho`] outside the reach.
pub const fn parse_range(reply: [u8; 2]) -> Result<Millimeters, RangeError> {
    check_range(Millimeters(u16::from_be_bytes(reply)))
}

/// Decodes a temperature reply: degrees Celsius plus 45.
///
/// # Errors
/// [`TemperatureError::Absurd`] outside [`COLDEST`] to [`WARMEST`].
pub const fn parse_temperature(reply: [u8; 1]) -> Result<Celsius, TemperatureError> {
    let [byte] = reply;
    let air = Celsius(byte as i16 - 45);
    if air.0 < COLDEST.0 || air.0 > WARMEST.0 {
        return Err(TemperatureError::Absurd(air));
    }
    Ok(air)
}

const fn check_range(range: Millimeters) -> Result<Millimeters, RangeError> {
    if range.0 < NEAREST.0 {
        Err(RangeError::TooNear(range))
    } else if range.0 > FARTHEST.0 {
        Err(RangeError::NoEcho(range))
    } else {
        Ok(range)
    }
}
