//! Ways from a simulated robot to the network.

pub(crate) mod fix;
#[cfg(feature = "live")]
pub(crate) mod live;
pub mod lockstep;
pub(crate) mod network;
mod none;
#[cfg(feature = "live")]
pub mod proxy;
pub mod radio;

pub use none::{NoMonitor, NoNetwork, NoStream};
