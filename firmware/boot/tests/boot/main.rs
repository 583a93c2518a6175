//! The decisions of the crate, held against other people's and against power cuts.

mod chip;
mod histories;
mod loader;
mod plans;
mod power_cuts;
mod robot;
mod selection;
