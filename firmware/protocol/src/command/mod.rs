//! Commands: what a robot is told to do.
//!
//! Reading takes two steps. `frame` turns bytes into a frame of bounded scalars and places, and remembers
//! the first thing that is wrong with it, so that `seq` and `source` survive a bad command and the
//! robot can answer `rejected`. `meaning` turns the frame into an [`Action`].

mod encode;
mod formation;
mod frame;
mod meaning;
mod places;
mod value;

use core::fmt;

pub use formation::{Formation, Shape};
pub use places::{MAX_PLACES, Places};
pub use value::{MAX_SET, ParameterValue, ParameterValues};

use crate::words::words;
use crate::{BehaviourName, EncodeError, PolicyName, Reason, RobotId, Source, json};

words! {
    /// The name of a command.
    CommandName {
        /// See [`Action::Move`].
        Move = "move",
        /// See [`Action::Drive`].
        Drive = "drive",
        /// See [`Action::Stop`].
        Stop = "stop",
        /// See [`Action::Estop`].
        Estop = "estop",
        /// See [`Action::Reset`].
        Reset = "reset",
        /// See [`Action::Scan`].
        Scan = "scan",
        /// See [`Action::Capture`].
        Capture = "capture",
        /// See [`Action::ReportMap`].
        ReportMap = "report_map",
        /// See [`Action::Behave`].
        Behave = "behave",
        /// See [`Action::Goto`].
        Goto = "goto",
        /// See [`Action::Set`].
        Set = "set",
        /// See [`Action::Identify`].
        Identify = "identify",
        /// See [`Action::Reboot`].
        Reboot = "reboot",
        /// See [`Action::Shadow`].
        Shadow = "shadow",
    }
}

words! {
    /// Where `move` goes.
    Direction {
        /// Straight ahead.
        Forward = "forward",
        /// Straight back.
        Backward = "backward",
        /// Counter-clockwise on the spot.
        Left = "left",
        /// Clockwise on the spot.
        Right = "right",
    }
}

/// Longest `move`, in milliseconds.
pub const MAX_MOVE_MS: u32 = 10_000;
/// Fastest `drive`, in m/s either way. A robot goes as fast as it can below that.
pub const MAX_DRIVE_V: f32 = 10.0;
/// Fastest turn of `drive`, in rad/s either way. A robot turns as fast as it can below that.
pub const MAX_DRIVE_W: f32 = 50.0;
/// Farthest coordinate of `goto`, in metres either way: there an `f32` still resolves a millimetre.
pub const MAX_COORDINATE: f32 = 10_000.0;
/// Speed of `wander` where none is given, in percent.
pub const DEFAULT_WANDER_SPEED: u8 = 60;
/// Least and largest distance that `follow` may keep, in metres: nearer, bodies would touch; farther, the
/// cells that a robot listens to may not reach.
pub const FOLLOW_DISTANCE: [f32; 2] = [0.25, 2.0];
/// Distance that `follow` keeps where none is given, in metres.
pub const DEFAULT_FOLLOW_DISTANCE: f32 = 0.6;
/// Largest value of `consensus` either way: what is agreed on are whole thousandths in 32 bits.
pub const MAX_VALUE: f32 = 1_000_000.0;
/// Most liars that `consensus` bears among the neighbours of a robot: to tell more from others it would have
/// to hear more than the sixteen that it knows.
pub const MAX_LIARS: u8 = 7;
/// Liars that `consensus` bears where it is not told how many.
pub const DEFAULT_LIARS: u8 = 1;
/// Most laps of `patrol`.
pub const MAX_LAPS: u16 = 1_000;

/// What to behave like from now on.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum BehaviourSpec {
    /// Do what you are told.
    Manual,
    /// Move about and avoid what is in the way.
    Wander {
        /// Top speed, 0 to 100 %.
        speed: u8,
    },
    /// Go to a place, avoiding what is in the way.
    Goto {
        /// Metres along the x axis.
        x: f32,
        /// Metres along the y axis.
        y: f32,
    },
    /// Keep away from other robots.
    Disperse,
    /// Join other robots at a place.
    Gather {
        /// Metres along the x axis; 0 where it is not given.
        x: f32,
        /// Metres along the y axis; 0 where it is not given.
        y: f32,
    },
    /// Move along with other robots.
    Flock,
    /// Keep a place among other robots, in a lattice round the origin.
    Formation,
    /// Keep a place in a shape.
    Shaped(Formation),
    /// Follow a trained policy.
    Policy {
        /// Its name.
        policy: PolicyName,
    },
    /// Keep behind a robot.
    Follow {
        /// The robot to follow.
        leader: RobotId,
        /// Metres to keep, within [`FOLLOW_DISTANCE`].
        distance: f32,
    },
    /// Go round by places, over and over.
    Patrol {
        /// Where to go, one after the other: at least two.
        waypoints: Places,
        /// After how many rounds to stop, up to [`MAX_LAPS`]; 0 is never.
        laps: u16,
    },
    /// Agree on a number.
    Consensus {
        /// What to begin with.
        measure: Measure,
        /// Most liars among the neighbours of a robot, up to [`MAX_LIARS`].
        f: u8,
    },
    /// Share tasks out, and go to the own one.
    Allocate {
        /// Where there is something to do: at least one.
        tasks: Places,
    },
    /// Cover a part of an area, as evenly as others do.
    Cover {
        /// Its corners: at least three.
        area: Places,
    },
}

/// What a robot begins to agree with.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// A number within ±[`MAX_VALUE`].
    Value(f32),
    /// The temperature of the air in °C.
    Temperature,
    /// What its ranger sees, in metres.
    Range,
}

impl BehaviourSpec {
    /// The behaviour without its parameters.
    #[must_use]
    pub const fn behaviour(&self) -> BehaviourName {
        match self {
            Self::Manual => BehaviourName::Manual,
            Self::Wander { .. } => BehaviourName::Wander,
            Self::Goto { .. } => BehaviourName::Goto,
            Self::Disperse => BehaviourName::Disperse,
            Self::Gather { .. } => BehaviourName::Gather,
            Self::Flock => BehaviourName::Flock,
            Self::Formation | Self::Shaped(_) => BehaviourName::Formation,
            Self::Policy { .. } => BehaviourName::Policy,
            Self::Follow { .. } => BehaviourName::Follow,
            Self::Patrol { .. } => BehaviourName::Patrol,
            Self::Consensus { .. } => BehaviourName::Consensus,
            Self::Allocate { .. } => BehaviourName::Allocate,
            Self::Cover { .. } => BehaviourName::Cover,
        }
    }

    /// The name on the wire.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.behaviour().name()
    }
}

/// What to do.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
// There is no heap to put the rare large variant on; who queues actions queues few.
#[allow(clippy::large_enum_variant)]
pub enum Action {
    /// Move one way for a time.
    Move {
        /// Which way.
        direction: Direction,
        /// 0 to 100 % of full duty.
        speed: u8,
        /// Milliseconds, up to [`MAX_MOVE_MS`]; 0 lasts until told otherwise. `duration` on the
        /// wire.
        duration_ms: u32,
    },
    /// Drive at this twist until told otherwise.
    Drive {
        /// Forward speed in m/s, within ±[`MAX_DRIVE_V`].
        v: f32,
        /// Turning speed in rad/s, counter-clockwise, within ±[`MAX_DRIVE_W`].
        w: f32,
    },
    /// Stop and stand.
    Stop,
    /// Stop at once and stand until `reset`.
    Estop,
    /// Leave the emergency stop, or an error.
    Reset,
    /// Turn once around and look.
    Scan,
    /// Take a picture.
    Capture,
    /// Tell the map of what is around, and the plan.
    ReportMap,
    /// Behave like this from now on.
    Behave(BehaviourSpec),
    /// Go to a place.
    Goto {
        /// Metres along the x axis, within ±[`MAX_COORDINATE`].
        x: f32,
        /// Metres along the y axis, within ±[`MAX_COORDINATE`].
        y: f32,
    },
    /// Set parameters; at least one.
    Set(ParameterValues),
    /// Show which robot you are.
    Identify,
    /// Start the program again.
    Reboot,
    /// Have a policy decide on what the one that drives sees, move nothing by it, and count how often both choose the same.
    Shadow {
        /// Its name; with none, which is where none is given, nothing is compared any more.
        policy: Option<PolicyName>,
    },
}

impl Action {
    /// Which command this is.
    #[must_use]
    pub const fn command(&self) -> CommandName {
        match self {
            Self::Move { .. } => CommandName::Move,
            Self::Drive { .. } => CommandName::Drive,
            Self::Stop => CommandName::Stop,
            Self::Estop => CommandName::Estop,
            Self::Reset => CommandName::Reset,
            Self::Scan => CommandName::Scan,
            Self::Capture => CommandName::Capture,
            Self::ReportMap => CommandName::ReportMap,
            Self::Behave(_) => CommandName::Behave,
            Self::Goto { .. } => CommandName::Goto,
            Self::Set(_) => CommandName::Set,
            Self::Identify => CommandName::Identify,
            Self::Reboot => CommandName::Reboot,
            Self::Shadow { .. } => CommandName::Shadow,
        }
    }

    /// The name on the wire.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.command().name()
    }

    /// Whether the command can make a robot move, and so expires with age.
    #[must_use]
    pub const fn is_motion(&self) -> bool {
        match self {
            Self::Move { .. }
            | Self::Drive { .. }
            | Self::Scan
            | Self::Behave(_)
            | Self::Goto { .. } => true,
            Self::Stop
            | Self::Estop
            | Self::Reset
            | Self::Capture
            | Self::ReportMap
            | Self::Set(_)
            | Self::Identify
            | Self::Reboot
            | Self::Shadow { .. } => false,
        }
    }

    /// Reads a request for a command: a [`Command`] without `timestamp`, `seq` and `source`, as a
    /// person sends it to the server.
    ///
    /// # Errors
    /// The first [`Reason`] why it is not one; `timestamp`, `seq` or `source` are unknown fields.
    pub fn parse(payload: &[u8]) -> Result<Self, Reason> {
        let frame = frame::read(payload, frame::Expect::Action);
        meaning::action(&frame)
    }

    /// Writes a request for the command as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError`] when it does not fit, or a number is not finite.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        json::to_slice(self, buf)
    }
}

/// A command as it travels.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// What to do.
    pub action: Action,
    /// When it was sent, in Unix milliseconds.
    pub timestamp: u64,
    /// Rises with each command of `source`.
    pub seq: u64,
    /// Who sent it.
    pub source: Source,
}

/// Why bytes are not a command, and what could be read of them nevertheless.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandError {
    /// The first thing wrong.
    pub reason: Reason,
    /// The number to answer to, where it could be read.
    pub seq: Option<u64>,
    /// Who to answer to, where it could be read.
    pub source: Option<Source>,
}

impl fmt::Display for CommandError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "not a command: {}", self.reason)
    }
}

impl core::error::Error for CommandError {}

impl Command {
    /// Reads a command from the whole of `payload`.
    ///
    /// # Errors
    /// [`CommandError`] with the first thing wrong, in this order: size and syntax, then the
    /// fields as they stand in the text, then what is missing, then what the parameters mean.
    // Out of line: the frame in between takes a kilobyte of stack, which is free again when the
    // command is carried out.
    #[inline(never)]
    pub fn parse(payload: &[u8]) -> Result<Self, CommandError> {
        let mut frame = frame::read(payload, frame::Expect::Command);
        meaning::command(&mut frame).map_err(|reason| CommandError {
            reason,
            seq: frame.seq,
            source: frame.source,
        })
    }

    /// Writes the command as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError`] when it does not fit, or a number is not finite.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        json::to_slice(self, buf)
    }
}
