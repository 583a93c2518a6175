//! Who has a data directory open. The operating system lets go of a lock when its holder dies, so a
//! crash leaves nothing to clean up.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;

use crate::RecordsError;

/// Held for as long as it lives.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

/// How a directory is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Beside others.
    Shared,
    /// Alone.
    Alone,
}

impl Lock {
    /// Takes the lock `file`, or `None` when somebody else has it in a way that does not go with
    /// `hold`. Never waits.
    ///
    /// # Errors
    /// [`RecordsError::Io`] when the operating system refuses.
    pub fn take(file: &Path, hold: Hold) -> Result<Option<Self>, RecordsError> {
        // Whoever can open it can hold it.
        crate::files::make_private(file)?;
        let opened = OpenOptions::new()
            .read(true)
            .write(true)
            .open(file)
            .map_err(|error| RecordsError::io(file, error))?;
        let taken = match hold {
            Hold::Shared => opened.try_lock_shared(),
            Hold::Alone => opened.try_lock(),
        };
        match taken {
            Ok(()) => Ok(Some(Self { _file: opened })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(RecordsError::io(file, error)),
        }
    }
}
