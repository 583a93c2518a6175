//! Why a recording ended early.

use std::fmt;
use std::path::PathBuf;

/// A recording cannot be made, or cannot go on. What was written up to the last chunk stays
/// readable.
#[derive(Debug)]
pub struct RecordError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong.
    pub cause: mcap::McapError,
}

impl fmt::Display for RecordError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "recording to {}: {}", self.path.display(), self.cause)
    }
}

impl std::error::Error for RecordError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.cause)
    }
}
