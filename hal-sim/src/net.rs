//! Ways from a simulated robot to the network.

mod fix;
#[cfg(feature = "live")]
pub(crate) mod live;
pub mod lockstep;
pub(crate) mod network;
mod none;
#[cfg(feature = "live")]
pub mod proxy;
pub mod radio;
#[cfg(feature = "live")]
pub(crate) mod tracker;

pub(crate) use fix::pose_fix;
pub use none::{NoMonitor, NoNetwork, NoStream};
