//! What is wrong with a frame, and how serving ends otherwise.

use std::error::Error;
use std::{fmt, io};

use super::VERSION;

/// Why a frame is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The input ended within it.
    Cut,
    /// Empty, or longer than any frame is.
    Length {
        /// What it says.
        told: u32,
        /// Bytes of the longest one.
        most: usize,
    },
    /// Of a kind that nobody asks.
    Kind(u8),
    /// Hello does not begin as it does in every version.
    Foreign,
    /// Hello of another version.
    Version(u16),
    /// A flag that this version does not have.
    Flags(u8),
    /// Hello is not the first one.
    NoHello,
    /// Hello once more.
    Again,
    /// As long as no frame of its kind is.
    Size {
        /// Its kind.
        kind: u8,
        /// Bytes that it has, without that of its kind.
        told: usize,
        /// Bytes that it should have.
        wanted: usize,
    },
    /// A world is told what no world can do.
    Order {
        /// Its number.
        world: usize,
        /// What it is told.
        order: u8,
    },
    /// There is no such action.
    Action {
        /// The number of its world.
        world: usize,
        /// Its number in the world.
        agent: usize,
        /// The action.
        action: u8,
        /// How many there are.
        actions: usize,
    },
    /// No evaluation has this seed.
    Seed {
        /// The number of its world.
        world: usize,
    },
    /// A world is to act, and has no episode that goes on.
    NoEpisode {
        /// Its number.
        world: usize,
    },
    /// What so many worlds answer does not go into a frame.
    Worlds,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Cut => f.write_str("the input ended within a frame"),
            Self::Length { told, most } => {
                write!(f, "a frame of {told} bytes; here it has 1 to {most}")
            }
            Self::Kind(kind) => write!(f, "a frame of the unknown kind {kind}"),
            Self::Foreign => f.write_str("no hello of this protocol"),
            Self::Version(version) => write!(
                f,
                "version {version} of the protocol; this program speaks version {VERSION}"
            ),
            Self::Flags(flags) => write!(f, "unknown flags {flags:#010b} in hello"),
            Self::NoHello => f.write_str("the first frame is no hello"),
            Self::Again => f.write_str("hello a second time"),
            Self::Size { kind, told, wanted } => write!(
                f,
                "{told} bytes in a frame of the kind {kind}, which should have {wanted}"
            ),
            Self::Order { world, order } => {
                write!(f, "world {world} is told {order}, which is 0 to 3")
            }
            Self::Action {
                world,
                agent,
                action,
                actions,
            } => write!(
                f,
                "action {action} of agent {agent} in world {world}; there are {actions}"
            ),
            Self::Seed { world } => {
                write!(
                    f,
                    "world {world} is to be evaluated with a seed of training"
                )
            }
            Self::NoEpisode { world } => write!(
                f,
                "world {world} is to act, and has no episode that goes on"
            ),
            Self::Worlds => f.write_str("more worlds than a frame has room for"),
        }
    }
}

impl Error for Fault {}

/// How serving ends, other than with the input.
#[derive(Debug)]
#[non_exhaustive]
pub enum ServeError {
    /// A frame was refused.
    Refused(Fault),
    /// The input cannot be read.
    Input(io::Error),
    /// Whoever asked does not read the answers.
    Output(io::Error),
}

impl fmt::Display for ServeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(fault) => fault.fmt(f),
            Self::Input(error) => write!(f, "the input cannot be read: {error}"),
            Self::Output(error) => write!(f, "nobody reads the answers: {error}"),
        }
    }
}

impl Error for ServeError {}

impl From<Fault> for ServeError {
    fn from(fault: Fault) -> Self {
        Self::Refused(fault)
    }
}
