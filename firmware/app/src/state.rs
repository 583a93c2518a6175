//! The state machine of a robot: one enum, one pure step function.
//!
//! `docs/robot-states.md` draws it, and a test holds the drawing to [`State::step`].

#[cfg(test)]
mod tests;

use crawler_hal::{Duration, Instant};
use crawler_protocol::RobotState;

use crate::goal::Goal;

/// Which way to turn aside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Side {
    /// Counter-clockwise.
    Left,
    /// Clockwise.
    Right,
}

impl Side {
    /// The other one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }
}

/// How the robot gets out of the way of what is ahead: back for a while, then turn for a while.
///
/// Times, and not angles, because without encoders a time is what the robot can keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Escape {
    /// How many attempts failed before this one.
    pub attempt: u8,
    /// Which way it turns.
    pub side: Side,
    /// Until here it backs off; then it turns.
    pub back_until: Instant,
    /// It does not look for a way out before this.
    pub least_until: Instant,
    /// From here on the attempt has failed.
    pub until: Instant,
}

impl Escape {
    /// Shortest turn. At the 2 rad/s of [`crate::behaviour`] about 30°.
    const LEAST_TURN: Duration = Duration::from_millis(250);
    /// A first turn: about 170°.
    const TURN: Duration = Duration::from_millis(1_500);
    /// A later turn: about 340°, so that every way out has been looked at.
    const FULL_TURN: Duration = Duration::from_millis(3_000);
    /// Backing off goes blind, so it is short: about 8 cm.
    const BACK: Duration = Duration::from_millis(600);

    /// The first attempt: only turn.
    pub fn turning(side: Side, now: Instant) -> Self {
        Self {
            attempt: 0,
            side,
            back_until: now,
            least_until: now + Self::LEAST_TURN,
            until: now + Self::TURN,
        }
    }

    /// An attempt that backs off first: after a failed one, or when caught on something that the
    /// ranger does not see.
    pub fn backing(attempt: u8, side: Side, now: Instant) -> Self {
        let back_until = now + Self::BACK;
        Self {
            attempt,
            side,
            back_until,
            least_until: back_until + Self::LEAST_TURN * (u32::from(attempt.min(3)) + 1),
            until: back_until + Self::FULL_TURN,
        }
    }
}

/// Why a robot stands and does not take orders to move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Fault {
    /// `estop`. Latched until `reset`.
    EmergencyStop,
    /// An output to the motors does not do what it is told.
    Motor,
    /// The battery is as good as empty.
    Battery,
    /// The ranger is dead, stuck or absurd, and driving without it is not permitted.
    Ranger,
}

impl Fault {
    /// Name in log records.
    pub const fn name(self) -> &'static str {
        match self {
            Self::EmergencyStop => "emergency-stop",
            Self::Motor => "motor",
            Self::Battery => "battery",
            Self::Ranger => "ranger",
        }
    }
}

/// What can happen to a robot, as far as its state is concerned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// The parameters are loaded and the sensors have been heard, or were given up.
    Ready,
    /// An order to move was accepted.
    Begin(Goal),
    /// An order to scan was accepted.
    BeginScan {
        /// When to give up.
        deadline: Instant,
    },
    /// The goal is over: done, timed out, stopped, or taken over.
    End,
    /// The way ahead is free.
    Free,
    /// Something is near, or another reason to be slow.
    Near,
    /// There is no fresh view of the way ahead.
    Blind,
    /// Something is too near to go on.
    Blocked(Side),
    /// The robot makes no headway.
    Stuck(Side),
    /// Something is wrong.
    Fault(Fault),
    /// Nothing is wrong any more.
    Recovered,
    /// `reset`.
    Reset,
    /// An update begins.
    BeginUpdate,
    /// The update is over, or goes on another time.
    EndUpdate,
}

/// State of a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum State {
    /// Starting.
    Initializing,
    /// Standing, ready for orders.
    Idle,
    /// Moving freely.
    Moving(Goal),
    /// Moving slowly, or waiting for a view of the way ahead.
    Caution(Goal),
    /// Turning aside.
    Avoiding(Goal, Escape),
    /// Turning once around itself, collecting ranges.
    Scanning {
        /// When to give up.
        deadline: Instant,
    },
    /// Standing; someone has to come, or a fault has to go.
    Error(Fault),
    /// Standing, while another program is received and written; takes no order to move.
    Updating,
}

impl State {
    /// Takes one step. Pure: reads no clock, draws no random number, does no I/O.
    ///
    /// Arms name states and events in full, so that a new one does not compile until it has
    /// been placed.
    #[must_use]
    // Arms are grouped by what happens, and not by where it leads.
    #[allow(clippy::match_same_arms)]
    pub fn step(self, event: Event, now: Instant) -> Self {
        match (self, event) {
            // A fault ends whatever goes on. The emergency stop hides every other fault, since
            // it alone does not go away by itself.
            (Self::Error(Fault::EmergencyStop), Event::Fault(_)) => self,
            (
                Self::Initializing
                | Self::Idle
                | Self::Moving(_)
                | Self::Caution(_)
                | Self::Avoiding(..)
                | Self::Scanning { .. }
                | Self::Updating
                | Self::Error(Fault::Motor | Fault::Battery | Fault::Ranger),
                Event::Fault(fault),
            ) => Self::Error(fault),
            (Self::Error(Fault::EmergencyStop), Event::Reset)
            | (Self::Error(Fault::Motor | Fault::Battery | Fault::Ranger), Event::Recovered)
            | (Self::Initializing, Event::Ready)
            | (Self::Updating, Event::EndUpdate) => Self::Idle,
            (Self::Idle, Event::BeginUpdate) => Self::Updating,

            // Orders. The latest one counts.
            (
                Self::Idle
                | Self::Moving(_)
                | Self::Caution(_)
                | Self::Avoiding(..)
                | Self::Scanning { .. },
                Event::Begin(goal),
            ) => Self::Moving(goal),
            (
                Self::Idle
                | Self::Moving(_)
                | Self::Caution(_)
                | Self::Avoiding(..)
                | Self::Scanning { .. },
                Event::BeginScan { deadline },
            ) => Self::Scanning { deadline },
            (
                Self::Moving(_) | Self::Caution(_) | Self::Avoiding(..) | Self::Scanning { .. },
                Event::End,
            ) => Self::Idle,

            // The way ahead.
            (Self::Moving(goal) | Self::Caution(goal), Event::Free) => Self::Moving(goal),
            (Self::Moving(goal) | Self::Caution(goal), Event::Near | Event::Blind) => {
                Self::Caution(goal)
            }
            (Self::Moving(goal) | Self::Caution(goal), Event::Blocked(side)) => {
                if goal.is_autonomous() {
                    Self::Avoiding(goal, Escape::turning(side, now))
                } else {
                    Self::Idle
                }
            }
            (Self::Moving(goal) | Self::Caution(goal), Event::Stuck(side)) => {
                if goal.is_autonomous() {
                    Self::Avoiding(goal, Escape::backing(0, side, now))
                } else {
                    self
                }
            }
            (Self::Avoiding(goal, escape), Event::Free) if now >= escape.least_until => {
                Self::Moving(goal)
            }
            (Self::Avoiding(goal, escape), Event::Near) if now >= escape.least_until => {
                Self::Caution(goal)
            }
            (Self::Avoiding(goal, escape), Event::Stuck(side)) => {
                let attempt = escape.attempt.saturating_add(1);
                Self::Avoiding(goal, Escape::backing(attempt, side, now))
            }

            // Spelled out, so that nothing is ignored by accident.
            (Self::Avoiding(..), Event::Free | Event::Near | Event::Blind | Event::Blocked(_))
            | (
                Self::Moving(_) | Self::Caution(_) | Self::Avoiding(..),
                Event::Ready
                | Event::Recovered
                | Event::Reset
                | Event::BeginUpdate
                | Event::EndUpdate,
            )
            | (
                Self::Scanning { .. },
                Event::Ready
                | Event::Recovered
                | Event::Reset
                | Event::Free
                | Event::Near
                | Event::Blind
                | Event::Blocked(_)
                | Event::Stuck(_)
                | Event::BeginUpdate
                | Event::EndUpdate,
            )
            | (
                Self::Idle,
                Event::Ready
                | Event::End
                | Event::Recovered
                | Event::Reset
                | Event::Free
                | Event::Near
                | Event::Blind
                | Event::Blocked(_)
                | Event::Stuck(_)
                | Event::EndUpdate,
            )
            | (
                Self::Initializing,
                Event::Begin(_)
                | Event::BeginScan { .. }
                | Event::End
                | Event::Recovered
                | Event::Reset
                | Event::Free
                | Event::Near
                | Event::Blind
                | Event::Blocked(_)
                | Event::Stuck(_)
                | Event::BeginUpdate
                | Event::EndUpdate,
            )
            | (
                Self::Error(Fault::EmergencyStop),
                Event::Ready
                | Event::Recovered
                | Event::Begin(_)
                | Event::BeginScan { .. }
                | Event::End
                | Event::Free
                | Event::Near
                | Event::Blind
                | Event::Blocked(_)
                | Event::Stuck(_)
                | Event::BeginUpdate
                | Event::EndUpdate,
            )
            | (
                Self::Error(Fault::Motor | Fault::Battery | Fault::Ranger),
                Event::Ready
                | Event::Reset
                | Event::Begin(_)
                | Event::BeginScan { .. }
                | Event::End
                | Event::Free
                | Event::Near
                | Event::Blind
                | Event::Blocked(_)
                | Event::Stuck(_)
                | Event::BeginUpdate
                | Event::EndUpdate,
            )
            | (
                Self::Updating,
                Event::Ready
                | Event::Begin(_)
                | Event::BeginScan { .. }
                | Event::End
                | Event::Recovered
                | Event::Reset
                | Event::Free
                | Event::Near
                | Event::Blind
                | Event::Blocked(_)
                | Event::Stuck(_)
                | Event::BeginUpdate,
            ) => self,
        }
    }

    /// The state as reported on the wire.
    pub const fn reported(&self) -> RobotState {
        match self {
            Self::Initializing => RobotState::Initializing,
            Self::Idle => RobotState::Idle,
            Self::Moving(_) => RobotState::Moving,
            Self::Caution(_) => RobotState::Caution,
            Self::Avoiding(..) => RobotState::Avoiding,
            Self::Scanning { .. } => RobotState::Scanning,
            Self::Error(_) => RobotState::Error,
            Self::Updating => RobotState::Updating,
        }
    }

    /// What the robot is about, when it is about anything.
    pub const fn goal(&self) -> Option<Goal> {
        match self {
            Self::Moving(goal) | Self::Caution(goal) | Self::Avoiding(goal, _) => Some(*goal),
            Self::Initializing
            | Self::Idle
            | Self::Scanning { .. }
            | Self::Error(_)
            | Self::Updating => None,
        }
    }

    /// The fault it stands for.
    pub const fn fault(&self) -> Option<Fault> {
        match self {
            Self::Error(fault) => Some(*fault),
            Self::Initializing
            | Self::Idle
            | Self::Moving(_)
            | Self::Caution(_)
            | Self::Avoiding(..)
            | Self::Scanning { .. }
            | Self::Updating => None,
        }
    }
}
