//! Ways from a simulated robot to the network.

#[cfg(feature = "live")]
pub(crate) mod live;
pub mod lockstep;
mod none;

pub use none::{NoMonitor, NoNetwork, NoStream};
