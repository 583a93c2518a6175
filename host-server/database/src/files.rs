//! Files that only the server may read, and that are there after a power cut.

use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};

use crate::RecordsError;

/// Makes an empty file that nobody else may read, unless there is one. `SQLite` gives the files that
/// it puts beside it the same permissions.
///
/// # Errors
/// [`RecordsError::Io`] when the operating system refuses.
pub fn make_private(path: &Path) -> Result<(), RecordsError> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.mode(0o600);
    }
    match options.open(path) {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
            Err(RecordsError::io(path, error))
        }
        _ => Ok(()),
    }
}

/// `path` with something behind its name.
#[must_use]
pub fn beside(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    PathBuf::from(name)
}

/// Waits until the file, or the list of files of the directory, is on disk.
///
/// # Errors
/// [`RecordsError::Io`] when the operating system refuses.
pub fn sync(path: &Path) -> Result<(), RecordsError> {
    File::open(path)
        .and_then(|file| file.sync_all())
        .map_err(|error| RecordsError::io(path, error))
}

/// Renames, and does not mind that there is nothing to rename.
///
/// # Errors
/// [`RecordsError::Io`] when the operating system refuses.
pub fn rename_if_there(from: &Path, to: &Path) -> Result<(), RecordsError> {
    match std::fs::rename(from, to) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(RecordsError::io(from, error))
        }
        _ => Ok(()),
    }
}

/// Removes, and does not mind that there is nothing to remove.
///
/// # Errors
/// [`RecordsError::Io`] when the operating system refuses.
pub fn remove_if_there(path: &Path) -> Result<(), RecordsError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(RecordsError::io(path, error))
        }
        _ => Ok(()),
    }
}
