//! The tests of accounts and of the audit log once more, with the records in `PostgreSQL`.
#![allow(
    clippy::duplicate_mod,
    reason = "each file is a test of its own, with its support"
)]

#[path = "accounts.rs"]
mod accounts;
#[path = "audit.rs"]
mod audit;
