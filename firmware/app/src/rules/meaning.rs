//! What the observer knows of the commands that were sent.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, BehaviourSpec};

/// What the observer expects of a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Meaning {
    /// Moves the robot until then; a lasting one is answered a second time when it ends.
    Motion {
        until: Instant,
        lasting: bool,
    },
    /// Ends motion, down the ramp.
    Rest,
    Halt,
    Reset,
    Other,
}

impl Meaning {
    pub(super) fn of(action: &Action, now: Instant) -> Self {
        match action {
            Action::Move { duration_ms: 0, .. } | Action::Drive { .. } => Self::Motion {
                until: now + Duration::from_millis(500),
                lasting: false,
            },
            Action::Move { duration_ms, .. } => Self::Motion {
                until: now + Duration::from_millis(u64::from(*duration_ms)),
                lasting: true,
            },
            Action::Goto { .. }
            | Action::Scan
            | Action::Behave(BehaviourSpec::Patrol { laps: 1.., .. }) => Self::Motion {
                until: Instant::FAR_FUTURE,
                lasting: true,
            },
            Action::Behave(BehaviourSpec::Manual) => Self::Rest,
            Action::Behave(_) => Self::Motion {
                until: Instant::FAR_FUTURE,
                lasting: false,
            },
            Action::Stop | Action::Estop => Self::Halt,
            Action::Reset => Self::Reset,
            _ => Self::Other,
        }
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Sent {
    pub(super) meaning: Meaning,
    /// Whether it is of this time.
    pub(super) legitimate: bool,
    /// How often it set the robot in motion.
    pub(super) begun: u32,
    pub(super) finals: u32,
}
