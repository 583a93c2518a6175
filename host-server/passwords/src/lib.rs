//! Checking passwords, at the API and at the broker alike.
//!
//! [`Hashing`] says how many are checked at a time, [`Failures`] who has guessed too often. What a password is,
//! and what is kept of it, is `crawler-access`'s to say.

mod failures;
mod hashing;

pub use failures::Failures;
pub use hashing::{Busy, Hashing};
