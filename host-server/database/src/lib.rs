//! What every database of a server stands on: a file that one task writes, and how a database goes wrong.
//!
//! A [`Db`] is one `SQLite` file with the tables of a [`Schema`], which it brings to their newest version.
//! Writes wait in a [`Queue`] for the one task that carries them out, and share transactions; reads go past
//! them. The same queue serves a database elsewhere, through [`Transact`]. A [`Lock`] says who has a
//! directory open, and ends with its process. Every failure is a [`RecordsError`], by what to do about it.
//!
//! What is in the tables is not known here: `crawler-records` has what must not be forgotten,
//! `crawler-history` what robots measured.
//!
//! Read [`Db`] first, then the queue.

mod error;
mod file;
mod files;
mod lock;
mod queue;
mod schema;

pub use error::{PATIENCE, RecordsError};
pub use file::Db;
pub use files::{beside, make_private, remove_if_there, rename_if_there, sync};
pub use lock::{Hold, Lock};
pub use queue::{Boxed, Queue, Transact, Waiting, Work, carry_out, queue, refuse, within};
pub use schema::{Schema, check_whole, unreadable};
