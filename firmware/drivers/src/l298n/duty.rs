//! Signed duty with 8 bits, and trim.

use super::ConfigError;

/// A signed share of full duty, in steps of 1/255; positive is forward.
///
/// Holds nothing but −255 to 255, so a duty out of range cannot be written down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Duty(i16);

impl Duty {
    /// Steps from zero to full: 8 bits.
    pub const STEPS: u8 = u8::MAX;
    /// Standing.
    pub const ZERO: Self = Self(0);
    /// Full forward.
    pub const FULL: Self = Self(Self::STEPS as i16);

    /// The duty nearest to `share`, −1 to 1. Beyond that it is clamped; what is not a finite
    /// number is zero, because whatever went wrong there should not move a robot.
    #[must_use]
    pub fn new(share: f32) -> Self {
        if !share.is_finite() {
            return Self::ZERO;
        }
        let steps = (share.abs().min(1.0) * f32::from(Self::STEPS) + 0.5) as i16;
        Self(if share < 0.0 { -steps } else { steps })
    }

    /// The duty of `steps` steps, clamped to ±[`Self::STEPS`].
    #[must_use]
    pub const fn from_steps(steps: i16) -> Self {
        let full = Self::STEPS as i16;
        Self(if steps > full {
            full
        } else if steps < -full {
            -full
        } else {
            steps
        })
    }

    /// Steps, −255 to 255.
    #[must_use]
    pub const fn steps(self) -> i16 {
        self.0
    }

    /// The share of full duty, −1 to 1.
    #[must_use]
    pub fn share(self) -> f32 {
        f32::from(self.0) / f32::from(Self::STEPS)
    }

    /// Steps without the direction.
    pub(super) const fn magnitude(self) -> u8 {
        // At most 255 by construction.
        self.0.unsigned_abs() as u8
    }
}

/// The share of its command a wheel gets, to make two unequal motors run equally: the stronger one
/// is held back, as the weaker one cannot be pushed beyond full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Trim {
    permille: u16,
}

impl Trim {
    /// The motor gets all of its command.
    pub const NONE: Self = Self { permille: 1_000 };
    /// Motors more unequal than this want repair, not trim.
    pub const WEAKEST: f32 = 0.5;

    /// A trim of `share`, [`Self::WEAKEST`] to 1, rounded to a thousandth.
    ///
    /// # Errors
    /// [`ConfigError::Trim`] outside that, or when `share` is not a number.
    pub const fn new(share: f32) -> Result<Self, ConfigError> {
        if share >= Self::WEAKEST && share <= 1.0 {
            Ok(Self {
                permille: (share * 1_000.0 + 0.5) as u16,
            })
        } else {
            Err(ConfigError::Trim)
        }
    }

    /// The share.
    #[must_use]
    pub fn share(self) -> f32 {
        f32::from(self.permille) * 1e-3
    }

    /// `duty` after trim, to the nearest step.
    pub(super) const fn apply(self, duty: Duty) -> Duty {
        let steps = (duty.magnitude() as u32 * self.permille as u32 + 500) / 1_000;
        Duty::from_steps(duty.steps().signum() * steps as i16)
    }
}
