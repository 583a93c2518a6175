//! The tests of accounts, of the audit log, of experiments, of fences and of events once more, with the
//! records in `PostgreSQL`.
#[path = "records/accounts.rs"]
mod accounts;
#[path = "records/audit.rs"]
mod audit;
#[path = "records/events.rs"]
mod events;
#[path = "records/experiments.rs"]
mod experiments;
#[path = "records/fences.rs"]
mod fences;
#[path = "records/support/mod.rs"]
mod support;
