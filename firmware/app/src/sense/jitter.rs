//! Uneven pauses between measurements.

use crawler_hal::Duration;

/// The longest pause.
const LONGEST_US: u64 = 32_000;

/// Pauses of up to 32 ms, other ones on each robot.
///
/// Two robots that face each other hear each other's bursts. Did both measure every 80 ms, then each would hear the
/// other's at the same moment of each measurement, for minutes, and see a thing where nothing stands. A burst that
/// comes 1 ms later looks 17 cm farther away.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Jitter(u32);

impl Jitter {
    /// Pauses of the robot of this name.
    #[must_use]
    pub const fn new(name: u32) -> Self {
        // The generator stays at 0 for ever.
        Self(name | 1)
    }

    /// The next pause. Marsaglia's xorshift32.
    pub fn draw(&mut self) -> Duration {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        Duration::from_micros((u64::from(self.0) * LONGEST_US) >> 32)
    }
}
