//! Policies that are learned, exactly: configuration, seed and environments determine every byte of the result.
//!
//! Two algorithms learn in an [`Environment`] with any number of agents that share a policy: [`ppo`], with a critic
//! that sees what an agent sees or more, and [`dqn`]. A run is a value that goes on round by round. Between rounds it
//! can be kept as bytes, and another process goes on from them as if nothing had happened. What was learned is a
//! [`Policy`]; [`statistics`] says what several runs came to.
//!
//! # The same bytes
//! Neither the number of threads nor the vectors of the processor make a difference ([`Compute`] says why). Functions
//! that processors and systems compute in different ways are of `libm`, or of this crate. Random numbers are drawn from
//! streams that belong to one purpose at one place of a run, so nothing depends on who draws first. What an environment
//! computes is its own affair: it has to be as exact.
//!
//! # Training and evaluation
//! An episode begins from a [`Seed`]. Those of training and those of evaluation have nothing in common, by how they are
//! made: what [`Policy::evaluate`] tells is never about episodes that were learned from.
//!
//! Reading order: `environment`, what is learned in; `network` on `kernel`, `math` and `compute`, which computes; `adam`
//! and `learner`, which change a network; `categorical` and `policy`, which choose actions; `actor`, an environment that
//! is acted in, and `batch`, many samples at once; `ppo` with `advantage`, and `dqn`; `config`, what both have in common;
//! `checkpoint`; `random`; `statistics`; `gym`, environments for those who learn elsewhere.
#![forbid(unsafe_code)]
// Kernels are inlined into whoever calls, with the vectors that the caller is compiled for.
#![allow(clippy::inline_always)]

mod actor;
mod adam;
mod advantage;
mod batch;
mod categorical;
mod checkpoint;
mod compute;
mod config;
pub mod dqn;
mod environment;
pub mod gym;
mod kernel;
mod learner;
mod math;
mod network;
mod policy;
pub mod ppo;
mod random;
pub mod statistics;

pub use checkpoint::CheckpointError;
pub use compute::Compute;
pub use config::{ConfigError, Diverged, Hidden};
pub use environment::{Environment, Episode, Interface, Seed, Status};
pub use network::{Activation, Network, Shape, Weights};
pub use policy::{Choice, Policy};
