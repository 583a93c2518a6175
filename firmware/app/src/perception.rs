//! What the robot knows of the way ahead: the hand-over from sense to control.

use crawler_hal::{Celsius, Duration, Instant, Millimeters};

/// A reading older than this moves no guarded robot.
pub const STALE_AFTER: Duration = Duration::from_millis(300);

/// What one measurement says of the way ahead.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Sight {
    /// Something stands this far ahead.
    Range(Millimeters),
    /// Nothing in reach of the sensor.
    Clear,
    /// Something stands nearer than the sensor can resolve.
    Touching,
}

impl Sight {
    /// The distance as the rest of the program compares it: [`Sight::Touching`] is 0 and
    /// [`Sight::Clear`] is farther than anything.
    pub const fn distance_mm(self) -> u16 {
        match self {
            Self::Range(mm) => mm.0,
            Self::Clear => u16::MAX,
            Self::Touching => 0,
        }
    }
}

/// Whether the ranger can be believed. A bad sensor is a state here, never a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SensorHealth {
    /// Nothing heard yet since boot.
    #[default]
    Unproven,
    /// Plausible readings keep arriving.
    Good,
    /// No usable reply for a second.
    Dead,
    /// The very same number again and again while the robot moves.
    Stuck,
    /// Readings jump about as nothing in the world does.
    Absurd,
}

impl SensorHealth {
    /// Whether the sensor has been found broken.
    pub const fn is_fault(self) -> bool {
        match self {
            Self::Dead | Self::Stuck | Self::Absurd => true,
            Self::Unproven | Self::Good => false,
        }
    }

    /// Name in log records.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unproven => "unproven",
            Self::Good => "good",
            Self::Dead => "dead",
            Self::Stuck => "stuck",
            Self::Absurd => "absurd",
        }
    }
}

/// The newest filtered reading, and what is thought of the sensor behind it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Reading {
    /// Newest trustworthy view, and when it was taken.
    pub sight: Option<(Sight, Instant)>,
    /// Whether the sensor can be believed.
    pub health: SensorHealth,
    /// Temperature at the sensor.
    pub temperature: Option<Celsius>,
}

impl Reading {
    /// The view, when it may still be acted upon at `now`: from a sensor in good health, and
    /// not older than [`STALE_AFTER`].
    pub fn fresh(&self, now: Instant) -> Option<Sight> {
        match self.sight {
            Some((sight, at)) if self.health == SensorHealth::Good && now - at <= STALE_AFTER => {
                Some(sight)
            }
            Some(_) | None => None,
        }
    }

    /// The range for telemetry: only a fresh one, and only when something is in reach.
    pub fn range_mm(&self, now: Instant) -> Option<u16> {
        match self.fresh(now) {
            Some(Sight::Range(mm)) => Some(mm.0),
            Some(Sight::Touching) => Some(0),
            Some(Sight::Clear) | None => None,
        }
    }
}

/// How much is left in the battery, as far as driving is concerned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Charge {
    /// Not measured yet, or the gauge cannot be read.
    #[default]
    Unknown,
    /// Enough.
    Good,
    /// Below `low_battery_mv`: drive slowly.
    Low,
    /// Below `critical_battery_mv`: stop and report.
    Critical,
}

impl Charge {
    /// Name in log records.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Good => "good",
            Self::Low => "low",
            Self::Critical => "critical",
        }
    }
}

/// The hand-over from power to control, store and link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Battery {
    /// Smoothed voltage of the pack.
    pub voltage: Option<crawler_hal::Millivolts>,
    /// State of charge.
    pub percent: Option<crawler_hal::Percent>,
    /// What follows for driving.
    pub charge: Charge,
    /// Whether the flash must not be written because the supply may give way.
    pub brown_out: bool,
}

/// What is known of the session with the broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinkHealth {
    /// There has been no session yet, or there is no network at all.
    #[default]
    Absent,
    /// A session is open.
    Up,
    /// A session was open and is known to be lost.
    Lost,
}
