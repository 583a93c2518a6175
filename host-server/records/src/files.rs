//! Files that only the server may read, and that are there after a power cut.

use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};

use crate::RecordsError;

/// Makes an empty file that nobody else may read, unless there is one. `SQLite` gives the files that
/// it puts beside it the same permissions.
pub(crate) fn make_private(path: &Path) -> Result<(), RecordsError> {
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
pub(crate) fn beside(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    PathBuf::from(name)
}

/// Refuses records of no bytes beside a history. A new server begins with such a file, but before there is
/// any history: these have been lost, and whoever comes next must not be taken for the first.
pub(crate) fn not_emptied(records: &Path, history: &Path) -> Result<(), RecordsError> {
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let is_empty = records.is_file() && length(records) == 0;
    if is_empty && length(&beside(records, "-wal")) == 0 && length(history) > 0 {
        return Err(RecordsError::damaged(
            records,
            "it is empty, although the server has run before",
        ));
    }
    Ok(())
}

/// Waits until the file, or the list of files of the directory, is on disk.
pub(crate) fn sync(path: &Path) -> Result<(), RecordsError> {
    File::open(path)
        .and_then(|file| file.sync_all())
        .map_err(|error| RecordsError::io(path, error))
}

/// Renames, and does not mind that there is nothing to rename.
pub(crate) fn rename_if_there(from: &Path, to: &Path) -> Result<(), RecordsError> {
    match std::fs::rename(from, to) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(RecordsError::io(from, error))
        }
        _ => Ok(()),
    }
}

/// Removes, and does not mind that there is nothing to remove.
pub(crate) fn remove_if_there(path: &Path) -> Result<(), RecordsError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(RecordsError::io(path, error))
        }
        _ => Ok(()),
    }
}
