//! One half of the bridge.

use crawler_hal::{Duration, Instant, MotorPort};
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;

use super::{Duty, Output, Trim, Wheel};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Direction {
    Forward,
    Reverse,
}

/// What the outputs hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum State {
    /// Anything: before the first command, and after an output refused.
    Unknown,
    /// Inputs equal, enable full.
    Braking,
    /// Inputs at the direction, enable at some duty above zero.
    Driving(Direction),
    /// Enable zero since `since`. Until the dead time is over, only `allowed` may be driven.
    Resting {
        since: Instant,
        allowed: Option<Direction>,
    },
}

/// One wheel.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Half<Pwm, Pin> {
    port: MotorPort<Pwm, Pin>,
    state: State,
}

impl<Pwm: SetDutyCycle, Pin: OutputPin> Half<Pwm, Pin> {
    pub(super) const fn new(port: MotorPort<Pwm, Pin>) -> Self {
        Self {
            port,
            state: State::Unknown,
        }
    }

    pub(super) const fn port(&self) -> &MotorPort<Pwm, Pin> {
        &self.port
    }

    pub(super) fn release(self) -> MotorPort<Pwm, Pin> {
        self.port
    }

    /// Drives at `command` where the dead time allows it, else rests.
    pub(super) fn drive(
        &mut self,
        command: Duty,
        trim: Trim,
        dead_time: Duration,
        now: Instant,
    ) -> Result<Wheel, Output> {
        let duty = trim.apply(command);
        let wanted = match duty.steps() {
            1.. => Some(Direction::Forward),
            0 => None,
            ..0 => Some(Direction::Reverse),
        };
        let Some(wanted) = wanted.filter(|&wanted| self.may_drive(wanted, dead_time, now)) else {
            self.rest(now)?;
            return Ok(Wheel::default());
        };
        if self.state != State::Driving(wanted) {
            self.turn_to(wanted)?;
        }
        self.enable(duty.magnitude())?;
        self.state = State::Driving(wanted);
        Ok(Wheel { command, duty })
    }

    /// Brakes at once.
    pub(super) fn brake(&mut self) -> Result<(), Output> {
        if self.state != State::Braking {
            // Off while the inputs change one by one: both may have been high before.
            self.enable(0)?;
            self.port.in1.set_low().map_err(|_| Output::In1)?;
            self.port.in2.set_low().map_err(|_| Output::In2)?;
        }
        self.enable(Duty::STEPS)?;
        self.state = State::Braking;
        Ok(())
    }

    /// Takes the wheel off the supply by whatever still obeys; true when one way succeeded.
    /// Either zero at the enable, or equal inputs, is enough.
    pub(super) fn make_safe(&mut self) -> bool {
        self.state = State::Unknown;
        let coasts = self.enable(0).is_ok();
        let in1 = self.port.in1.set_low().is_ok();
        let in2 = self.port.in2.set_low().is_ok();
        coasts || (in1 && in2)
    }

    fn may_drive(&self, wanted: Direction, dead_time: Duration, now: Instant) -> bool {
        match self.state {
            State::Unknown | State::Braking => false,
            State::Driving(direction) => direction == wanted,
            State::Resting { since, allowed } => {
                allowed == Some(wanted) || now - since >= dead_time
            }
        }
    }

    /// Enable to zero. The clock of the dead time starts with the first zero and is not restarted
    /// by the ones after it.
    fn rest(&mut self, now: Instant) -> Result<(), Output> {
        let resting = match self.state {
            State::Unknown | State::Braking => State::Resting {
                since: now,
                allowed: None,
            },
            State::Driving(direction) => State::Resting {
                since: now,
                allowed: Some(direction),
            },
            resting @ State::Resting { .. } => resting,
        };
        self.enable(0)?;
        self.state = resting;
        Ok(())
    }

    /// Sets the inputs. The enable is at zero whenever the direction changes, because only a wheel
    /// at rest gets here.
    fn turn_to(&mut self, direction: Direction) -> Result<(), Output> {
        let MotorPort { in1, in2, .. } = &mut self.port;
        // Low before high, so that a short to the brake is never followed by a jump.
        match direction {
            Direction::Forward => {
                in2.set_low().map_err(|_| Output::In2)?;
                in1.set_high().map_err(|_| Output::In1)
            }
            Direction::Reverse => {
                in1.set_low().map_err(|_| Output::In1)?;
                in2.set_high().map_err(|_| Output::In2)
            }
        }
    }

    fn enable(&mut self, steps: u8) -> Result<(), Output> {
        self.port
            .enable
            .set_duty_cycle_fraction(u16::from(steps), u16::from(Duty::STEPS))
            .map_err(|_| Output::Enable)
    }
}
