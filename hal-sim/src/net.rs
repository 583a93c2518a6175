//! Ways from a simulated robot to the network.
//!
//! Reading order: `network` is the one type that programs are compiled for, and chooses between
//! `none`, [`lockstep`] (a broker in the process, in virtual time) and `live` (real sockets);
//! [`radio`] says how well a robot is heard in either, `proxy` lets other programs share it, `fix`
//! is what the camera above the arena tells.

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
