//! The tests of accounts, of the audit log, of experiments, of fences, of events, of releases and of rollouts once
//! more, with the records in `PostgreSQL`.
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
#[path = "records/parts.rs"]
mod parts;
#[path = "records/releases.rs"]
mod releases;
#[path = "records/rollouts.rs"]
mod rollouts;
#[path = "records/support/mod.rs"]
mod support;
