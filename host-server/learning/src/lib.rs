//! Policies for robots: worlds to learn in, training, and what a robot takes of it.
//!
//! A robot that learns is in a bare world (`crawler_sim::run::bare`), with the body, the ranger and the motors of any
//! simulated robot. What it observes, what its actions do and what its shield takes away is code of the robot program
//! (`crawler_app::policy`), on top of the program's filters, odometry, ramps and motor driver. What comes over the
//! network under the firmware comes here as often, as late and as noisy: fixes, and who is near.
//!
//! Reading order: `agent`, one robot; `outside`, what comes to robots from outside; `spread`, the environment with its task; `teammates`,
//! the same for one learner; `export`, from what was learned to a blob for robots; `run`, a training run with its files;
//! `curve` and
//! `tensorboard`, two of these; `train`, the same from a command line; `gym`, the environment for those who learn elsewhere.
#![forbid(unsafe_code)]

mod agent;
mod curve;
mod export;
pub mod gym;
mod outside;
mod run;
mod spread;
mod teammates;
mod tensorboard;
pub mod train;

pub use curve::Line;
pub use export::{Header, Unfit, export};
pub use run::{JUDGED, Judged, Options, Run, RunError, Summary};
pub use spread::{Driven, Spread};
pub use teammates::Teammates;
pub use tensorboard::NAME as EVENTS;
