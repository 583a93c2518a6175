//! Running a scenario on many seeds, and what comes of it.
//!
//! A [`Trial`] is one run in lockstep, measured. Many of them make an [`Evaluation`]: means with
//! confidence intervals, thresholds, and the seeds that failed. Trials run in parallel, a world to
//! a thread; what comes out does not depend on how many threads there are.

mod adversary;
mod batch;
mod behaving;
mod clearance;
mod commands;
mod driver;
mod found;
mod judge;
mod metrics;
mod missions;
mod pattern;
mod report;
mod shape;
mod shrink;
mod statistics;
mod swarm;
mod sweep;
mod trial;
mod verdict;

pub use adversary::{Find, Search, invariants};
pub use batch::{Done, Job, run_all, run_unless};
pub use driver::{Driver, ideal, wandering};
pub use metrics::Measured;
pub use report::{Evaluation, Line, Verdict};
pub use shrink::{Shrunk, shrink};
pub use statistics::{Estimate, of_mean, of_paired_shares, of_share, rank_correlation};
pub use sweep::{Axis, Cell, Influence, NoAxis, drawn, grid, influences, jobs};
pub use trial::{Trial, run_to_end, run_to_failure, run_trial, run_trial_unless};
pub use verdict::{Criterion, Failure};
