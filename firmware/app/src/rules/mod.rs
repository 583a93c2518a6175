//! The safety rules of the robot as property tests: random events drive the loop that the control
//! activity runs, and an observer who knows nothing of its code watches the duties.

mod activities;
mod bench;
mod continuous;
mod happening;
mod invariants;
mod meaning;
mod orders;
mod resuming;
