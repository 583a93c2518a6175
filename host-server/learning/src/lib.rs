//! Policies for robots: worlds to learn in, training, and what a robot takes of it.
//!
//! A robot that learns is in a bare world (`crawler_sim::run::bare`), with the body, the ranger and the motors of any
//! simulated robot. What it observes, what its actions do and what its shield takes away is code of the robot program
//! (`crawler_app::policy`), on top of the program's filters, odometry, ramps and motor driver. What comes over the
//! network under the firmware comes here as often, as late and as noisy: fixes, and who is near.
//!
//! Reading order: `agent`, one robot; `outside`, what comes to robots from outside; `spread`, the environment with its task; `teammates`,
//! the same for one learner; `export`, from what was learned to a blob for robots; `curve` and
//! `tensorboard`, what is told of each round, and `files`, where; `judge`, what a policy came to; `error`, why a run ends; `run`, a training run;
//! `federated`, one of many nodes; `train`, a run from a command line; `gym`, the environment for those who learn elsewhere.
#![forbid(unsafe_code)]

mod agent;
mod curve;
mod error;
mod export;
pub mod federated;
mod files;
pub mod gym;
mod judge;
mod outside;
mod run;
mod spread;
mod teammates;
mod tensorboard;
pub mod train;

pub use curve::Line;
pub use error::RunError;
pub use export::{Header, Unfit, export};
pub use judge::{JUDGED, Judged, Summary};
pub use run::{Options, Run};
pub use spread::{Driven, Spread};
pub use teammates::Teammates;
pub use tensorboard::NAME as EVENTS;
