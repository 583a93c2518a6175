//! L298N motor driver: two wheels.
//!
//! Each wheel has an enable input on PWM and two direction inputs. The L298 data sheet
//! (ST, January 2000, figure 6, "bidirectional DC motor control") gives:
//!
//! | enable | in1 | in2 | motor |
//! |---|---|---|---|
//! | high | high | low | forward |
//! | high | low | high | reverse |
//! | high | equal | equal | fast stop: *brake* |
//! | low | any | any | free running stop: *coast* |
//!
//! The duty has 8 bits, [`Duty::STEPS`] steps. The body sets the PWM to 5 kHz: well under the
//! 25 kHz the data sheet names as typical commutation frequency, so the bipolar switches stay
//! cool, and fast enough that the current of a small motor (time constant of about a millisecond)
//! hardly ripples. 5 kHz × 256 steps = 1.28 MHz, which any timer clock divides down to.
//!
//! The driver holds a wheel at zero for the dead time before it reverses, whatever it is told.
//! Bounded steps of speed are the business of the control loop; [`Applied`] tells it what the
//! pins really got.

use core::fmt;

use crawler_hal::{Duration, Instant, MotorPort};
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;

mod duty;
mod wheel;

#[cfg(test)]
mod tests;

pub use duty::{Duty, Trim};
use wheel::Half;

/// A setting makes no sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ConfigError {
    /// A trim outside [`Trim::WEAKEST`] to 1, or not a number.
    Trim,
    /// A dead time outside [`Config::SHORTEST_DEAD_TIME`] to [`Config::LONGEST_DEAD_TIME`].
    DeadTime,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Trim => "motor trim is not within 0.5 to 1",
            Self::DeadTime => "motor dead time is not within 1 ms to 1 s",
        })
    }
}

impl core::error::Error for ConfigError {}

/// How the wheels are driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    left: Trim,
    right: Trim,
    dead_time: Duration,
}

impl Config {
    /// Less is less than the current in a winding takes to die down.
    pub const SHORTEST_DEAD_TIME: Duration = Duration::from_millis(1);
    /// More is a robot that seems broken.
    pub const LONGEST_DEAD_TIME: Duration = Duration::from_millis(1_000);

    /// No trim, and a dead time of 40 ms, two control periods: the current of a small geared
    /// motor (2 mH, 5 Ω) is gone after 2 ms, and the rest lets the wheel slow down, so that its
    /// own voltage does not add to the supply's when the bridge reverses.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            left: Trim::NONE,
            right: Trim::NONE,
            dead_time: Duration::from_millis(40),
        }
    }

    /// The same with other trims.
    #[must_use]
    pub const fn with_trim(self, left: Trim, right: Trim) -> Self {
        Self {
            left,
            right,
            ..self
        }
    }

    /// The same with another dead time.
    ///
    /// # Errors
    /// [`ConfigError::DeadTime`] outside [`Self::SHORTEST_DEAD_TIME`] to
    /// [`Self::LONGEST_DEAD_TIME`].
    pub const fn with_dead_time(self, dead_time: Duration) -> Result<Self, ConfigError> {
        let us = dead_time.as_micros();
        if us < Self::SHORTEST_DEAD_TIME.as_micros() || us > Self::LONGEST_DEAD_TIME.as_micros() {
            return Err(ConfigError::DeadTime);
        }
        Ok(Self { dead_time, ..self })
    }

    /// How long a wheel stands at zero before it reverses.
    #[must_use]
    pub const fn dead_time(&self) -> Duration {
        self.dead_time
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::new()
    }
}

/// Which wheel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// On the left.
    Left,
    /// On the right.
    Right,
}

/// Which output of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Output {
    /// ENA or ENB, the PWM channel.
    Enable,
    /// IN1 or IN3.
    In1,
    /// IN2 or IN4.
    In2,
}

/// An output that refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Fault {
    /// Of which wheel.
    pub side: Side,
    /// Which output.
    pub output: Output,
}

/// Why a command was not carried out. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MotorError {
    /// An output refused, and both wheels were taken off the supply. Report it; a later command
    /// may be tried.
    Stopped(Fault),
    /// An output refused, and neither the enable nor the direction inputs of a wheel could be
    /// made safe: it may be turning. Restart the controller, which resets its pins.
    Runaway(Fault),
}

impl fmt::Display for MotorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (fault, end) = match self {
            Self::Stopped(fault) => (fault, "wheels stopped"),
            Self::Runaway(fault) => (fault, "wheel may be turning"),
        };
        write!(f, "motor {:?} {:?}: {end}", fault.side, fault.output)
    }
}

impl core::error::Error for MotorError {}

/// What one wheel got.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Wheel {
    /// The command in force: the one given, or zero during the dead time. What odometry counts
    /// with, because the trim only makes unequal motors equal.
    pub command: Duty,
    /// What the enable input got, after trim; the sign is the direction.
    pub duty: Duty,
}

/// What the wheels got.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Applied {
    /// On the left.
    pub left: Wheel,
    /// On the right.
    pub right: Wheel,
}

/// Two wheels on one L298N.
///
/// Nothing is known of the pins before the first call, so a wheel starts by standing at zero for
/// the dead time, as it does after an error.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct L298n<Pwm, Pin> {
    left: Half<Pwm, Pin>,
    right: Half<Pwm, Pin>,
    config: Config,
}

impl<Pwm: SetDutyCycle, Pin: OutputPin> L298n<Pwm, Pin> {
    /// A driver of two wheels. Does no I/O.
    pub const fn new(
        left: MotorPort<Pwm, Pin>,
        right: MotorPort<Pwm, Pin>,
        config: Config,
    ) -> Self {
        Self {
            left: Half::new(left),
            right: Half::new(right),
            config,
        }
    }

    /// The settings in force.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// Other settings, from the next command on. A dead time that is running takes the new length.
    pub const fn set_config(&mut self, config: Config) {
        self.config = config;
    }

    /// Drives both wheels at `left` and `right`, as far as the dead time allows at `now`, and
    /// tells what they got. Call it every control period, also with an unchanged command: a
    /// reversal is finished by the first call after the dead time.
    ///
    /// # Errors
    /// [`MotorError`] when an output refuses. Both wheels are then stopped, as far as the outputs
    /// allow.
    pub fn apply(&mut self, left: Duty, right: Duty, now: Instant) -> Result<Applied, MotorError> {
        let Config {
            left: left_trim,
            right: right_trim,
            dead_time,
        } = self.config;
        let left = self.left.drive(left, left_trim, dead_time, now);
        let left = left.map_err(|output| self.stop_after(Side::Left, output))?;
        let right = self.right.drive(right, right_trim, dead_time, now);
        let right = right.map_err(|output| self.stop_after(Side::Right, output))?;
        Ok(Applied { left, right })
    }

    /// Takes both wheels off the supply at once; they roll out.
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn coast(&mut self, now: Instant) -> Result<(), MotorError> {
        self.apply(Duty::ZERO, Duty::ZERO, now).map(|_| ())
    }

    /// Shorts both motors through the bridge at once; they stop hard. Leaving the brake takes the
    /// dead time, in either direction.
    ///
    /// The data sheet (section 2, "suggestions") wants no more than 2 A while braking: that is the
    /// voltage a motor gives at the speed it has, over the resistance of its winding. Slow down
    /// first where that could be more.
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn brake(&mut self) -> Result<(), MotorError> {
        let left = self.left.brake();
        left.map_err(|output| self.stop_after(Side::Left, output))?;
        let right = self.right.brake();
        right.map_err(|output| self.stop_after(Side::Right, output))
    }

    /// The ports on the left and right.
    pub const fn ports(&self) -> [&MotorPort<Pwm, Pin>; 2] {
        [self.left.port(), self.right.port()]
    }

    /// Gives the ports back, as they are.
    pub fn release(self) -> (MotorPort<Pwm, Pin>, MotorPort<Pwm, Pin>) {
        (self.left.release(), self.right.release())
    }

    /// Stops both wheels as well as the outputs allow: one broken wheel must not leave a robot
    /// spinning on the other.
    fn stop_after(&mut self, side: Side, output: Output) -> MotorError {
        let fault = Fault { side, output };
        let left = self.left.make_safe();
        let right = self.right.make_safe();
        if left && right {
            MotorError::Stopped(fault)
        } else {
            MotorError::Runaway(fault)
        }
    }
}
