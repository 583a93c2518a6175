//! Faults put into this robot on purpose, on a bench.
//!
//! A program built with the feature `faults`, on a robot whose [`Config::faults`] is set, obeys
//! `inject` and `heal` of `simulator/command` where they name it, as far as a program can break
//! its own body. Without the feature there is nothing here but calls that do nothing.
//!
//! No fault makes a robot move: a range is replaced before it is judged, a duty is only ever
//! made smaller, a link is only ever lost.
//!
//! [`Config::faults`]: crate::Config::faults

#[cfg(not(feature = "faults"))]
mod never;
#[cfg(feature = "faults")]
mod obey;
#[cfg(all(test, feature = "faults"))]
mod tests;

#[cfg(not(feature = "faults"))]
pub(crate) use never::Injected;
#[cfg(feature = "faults")]
pub(crate) use obey::Injected;
