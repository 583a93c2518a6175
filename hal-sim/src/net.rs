//! Ways from a simulated robot to the network.

pub mod lockstep;
mod none;

pub use none::{NoMonitor, NoNetwork, NoStream};
