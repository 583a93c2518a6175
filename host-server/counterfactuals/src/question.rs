//! What is asked.

use std::fmt;

use crawler_protocol::{Action, RobotId};

/// Milliseconds between the points of an answer.
pub const STEP_MS: u32 = 250;
/// Longest time after the moment, seconds.
pub const MOST_SECONDS: u32 = 60;
/// Most draws.
pub const MOST_DRAWS: u32 = 200;
/// Most robots of one world; of a larger fleet those count that are near.
pub const MOST_ROBOTS: usize = 200;
/// Robots times seconds times draws: of one world about half a minute of a core.
const MOST_WORK: usize = 120_000;

/// What if?
#[derive(Debug, Clone, PartialEq)]
pub struct Question {
    /// The moment, Unix milliseconds.
    pub at_ms: i64,
    /// How long after it, seconds: 1 to [`MOST_SECONDS`].
    pub seconds: u32,
    /// How often bodies, noise and chance are drawn: 2 to [`MOST_DRAWS`].
    pub draws: u32,
    /// Who is told something else; everybody where it is left out.
    pub robots: Option<Vec<RobotId>>,
    /// What they are told at the moment.
    pub action: Action,
}

/// Whether a command makes a difference to where robots are.
#[must_use]
pub fn moves(action: &Action) -> bool {
    action.is_motion() || matches!(action, Action::Stop | Action::Estop | Action::Reset)
}

/// The question takes longer than anybody waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooMuch {
    /// Robots that are told something else.
    pub robots: usize,
    /// As many as there may be of a question this long, with so many draws.
    pub most: usize,
}

impl fmt::Display for TooMuch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robots, most } = self;
        write!(
            f,
            "{robots} robots are asked about, and for so long and so often it may be {most}: ask for fewer seconds or draws"
        )
    }
}

impl std::error::Error for TooMuch {}

impl Question {
    /// Points of each robot: one at the moment, and one every [`STEP_MS`].
    #[must_use]
    pub const fn points(&self) -> usize {
        (self.seconds * 1_000 / STEP_MS) as usize + 1
    }

    /// As many robots as there may be in a world of it.
    pub(crate) const fn room(&self) -> usize {
        let room = MOST_WORK / (self.seconds as usize * self.draws as usize);
        if room < MOST_ROBOTS {
            room
        } else {
            MOST_ROBOTS
        }
    }

    /// Whether a robot is told something else.
    pub(crate) fn asks(&self, robot: &RobotId) -> bool {
        let named = self.robots.as_ref();
        named.is_none_or(|robots| robots.contains(robot))
    }
}
