//! The tests of accounts, of the audit log, of experiments, of fences and of events once more, with the
//! records in `PostgreSQL`.
#![allow(
    clippy::duplicate_mod,
    reason = "each file is a test of its own, with its support"
)]

#[path = "accounts.rs"]
mod accounts;
#[path = "audit.rs"]
mod audit;
#[path = "events.rs"]
mod events;
#[path = "experiments.rs"]
mod experiments;
#[path = "fences.rs"]
mod fences;
