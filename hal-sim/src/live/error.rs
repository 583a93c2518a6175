//! What can go wrong with a live world.

use std::fmt;
use std::io;

use crate::net::proxy::ProxyError;
use crate::run::SimulationError;

/// Why a live world cannot start, or did not end as it should.
#[derive(Debug)]
#[non_exhaustive]
pub enum LiveError {
    /// The simulation cannot be set up.
    Simulation(SimulationError),
    /// The broker's host name is too long or does not resolve.
    Host(String, Option<io::Error>),
    /// The process may not open as many sockets: how many it may, and needs.
    Descriptors(u64, u64),
    /// The radio between robots and broker cannot start.
    Radio(ProxyError),
    /// The recording cannot be written.
    Record(String),
    /// No thread or no runtime.
    Runtime(io::Error),
    /// The world's thread ended by itself: a defect.
    Crashed,
    /// The world did not end in time.
    TimedOut,
}

impl fmt::Display for LiveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulation(error) => error.fmt(f),
            Self::Radio(error) => error.fmt(f),
            Self::Host(host, None) => write!(f, "broker host {host:?} is no host name"),
            Self::Host(host, Some(error)) => write!(f, "broker host {host:?}: {error}"),
            Self::Descriptors(have, need) => write!(
                f,
                "{need} open files are needed and {have} allowed: raise the limit (ulimit -n)"
            ),
            Self::Record(text) => f.write_str(text),
            Self::Runtime(error) => write!(f, "starting the world's thread: {error}"),
            Self::Crashed => f.write_str("the world's thread ended unexpectedly"),
            Self::TimedOut => f.write_str("the world did not end in time"),
        }
    }
}

impl std::error::Error for LiveError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Simulation(error) => Some(error),
            Self::Radio(error) => Some(error),
            Self::Host(_, Some(error)) | Self::Runtime(error) => Some(error),
            Self::Host(_, None)
            | Self::Descriptors(..)
            | Self::Record(_)
            | Self::Crashed
            | Self::TimedOut => None,
        }
    }
}
