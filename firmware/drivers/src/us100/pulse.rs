//! Trigger and echo.

use core::pin::pin;

use crawler_hal::{Celsius, Clock, Duration, Instant, Millimeters, with_deadline};
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;

use super::{COLDEST, LinkError, REPLY_TIMEOUT, TRIGGER, WARMEST};

/// Starts a measurement and returns how long Echo was high.
pub(super) async fn measure<T: OutputPin, E: InputPin + Wait, C: Clock>(
    trigger: &mut T,
    echo: &mut E,
    clock: &C,
) -> Result<Duration, LinkError> {
    // The same budget as over the UART; the trigger is a thousandth of it.
    let deadline = clock.now() + REPLY_TIMEOUT;
    // Low first: a call dropped half-way may have left it high.
    trigger.set_low().map_err(|_| LinkError::Pin)?;
    if echo.is_high().map_err(|_| LinkError::Pin)? {
        return Err(LinkError::EchoStuck);
    }
    trigger.set_high().map_err(|_| LinkError::Pin)?;
    clock.sleep(TRIGGER).await;
    trigger.set_low().map_err(|_| LinkError::Pin)?;

    // The sensor sends its burst, 0.2 ms, before it raises Echo, so there is time to listen. The
    // level and not the edge, in case this task was late all the same.
    before(clock, deadline, echo.wait_for_high(), LinkError::Timeout).await?;
    let start = clock.now();
    before(clock, deadline, echo.wait_for_low(), LinkError::EchoStuck).await?;
    Ok(clock.now() - start)
}

async fn before<C: Clock, E>(
    clock: &C,
    deadline: Instant,
    level: impl Future<Output = Result<(), E>>,
    late: LinkError,
) -> Result<(), LinkError> {
    // Lent, not moved: whoever awaits a future keeps it a second time.
    with_deadline(clock, deadline, pin!(level))
        .await
        .map_err(|_| late)?
        .map_err(|_| LinkError::Pin)
}

/// Speed of sound in air, in millimetres per second: 331.3 m/s at 0 °C and 0.606 m/s more per
/// degree, the usual linear form of 331.3 m/s · √(T / 273.15 K). It is within 0.2 % of that up to
/// 35 °C, and 0.7 % at 70 °C. `air` is clamped to [`COLDEST`] to [`WARMEST`].
#[must_use]
pub fn speed_of_sound_mm_per_s(air: Celsius) -> u32 {
    let air = i32::from(air.clamp(COLDEST, WARMEST).0);
    // At least 319,180 at −20 °C.
    (331_300 + 606 * air).unsigned_abs()
}

/// The range whose echo takes `width`, there and back, to the nearest millimetre; saturates.
#[must_use]
pub fn echo_range(width: Duration, air: Celsius) -> Millimeters {
    let path_nm = width
        .as_micros()
        .saturating_mul(u64::from(speed_of_sound_mm_per_s(air)));
    let range_mm = path_nm.saturating_add(1_000_000) / 2_000_000;
    Millimeters(u16::try_from(range_mm).unwrap_or(u16::MAX))
}

/// How long the echo from `range` takes, there and back, to the nearest microsecond. The other way
/// round, for models of the sensor.
#[must_use]
pub fn echo_width(range: Millimeters, air: Celsius) -> Duration {
    let speed = u64::from(speed_of_sound_mm_per_s(air));
    Duration::from_micros((u64::from(range.0) * 2_000_000 + speed / 2) / speed)
}
