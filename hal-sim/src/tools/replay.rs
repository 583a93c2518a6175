//! Recordings, run through the program once more.
//!
//! A program is a function of what its devices say. [`replay`] gives the program of this build
//! what the devices of each recorded robot said, at the moments they said it, perhaps with other
//! parameters, and compares what it does with what was done: duties, lamp, state, requests to
//! the ranger, published messages, resets. From the first difference on the two are different
//! robots, and what the devices of one say means nothing to the other; so that is what is told.

mod compare;
mod messages;
mod play;
mod read;

pub use compare::{Difference, ProgramAction};
pub use messages::{Message, messages};
pub use play::{ReplayError, Report, replay};
pub(crate) use read::{MarkLine, check_format, check_profile, line, scan, wrong};
pub use read::{ReadError, Recording};
