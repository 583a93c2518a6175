//! The data directory: one server at a time, and what must survive a restart.

pub mod test_disk;

use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Why the data directory cannot be used.
#[derive(Debug)]
#[non_exhaustive]
pub enum DataError {
    /// It cannot be made or written.
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What the operating system said.
        cause: io::Error,
    },
    /// Another server uses it.
    InUse(PathBuf),
    /// A file in it is not what this program wrote.
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        text: &'static str,
    },
}

impl std::fmt::Display for DataError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io { path, cause } => write!(
                f,
                "cannot use the data directory: {}: {cause}",
                path.display()
            ),
            Self::InUse(path) => write!(
                f,
                "the data directory {} is in use by another server",
                path.display()
            ),
            Self::Damaged { path, text } => write!(f, "{}: {text}", path.display()),
        }
    }
}

impl std::error::Error for DataError {}

/// Makes a directory, and those above it, that nobody else may look into. One that is there stays as
/// it is.
///
/// # Errors
/// What the system says.
pub fn make_private(path: &Path) -> io::Result<()> {
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
}

/// Brings what was written onto the disk. Tests put in front of that what disks do: they are slow, and
/// they fail.
#[derive(Clone, Default)]
pub struct Disk(Option<Arc<Gate>>);

type Gate = dyn Fn() -> io::Result<()> + Send + Sync;

impl Disk {
    /// A disk that does what `gate` says before it does anything.
    pub fn behind(gate: impl Fn() -> io::Result<()> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(gate)))
    }

    fn pass(&self) -> io::Result<()> {
        self.0.as_ref().map_or(Ok(()), |gate| gate())
    }

    /// Returns when the bytes of a file are safe.
    ///
    /// # Errors
    /// What the disk says.
    pub fn sync_data(&self, file: &File) -> io::Result<()> {
        self.pass()?;
        file.sync_data()
    }

    /// Returns when a file, or the names in a directory, are safe.
    ///
    /// # Errors
    /// What the disk says.
    pub fn sync_all(&self, file: &File) -> io::Result<()> {
        self.pass()?;
        file.sync_all()
    }
}

impl std::fmt::Debug for Disk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Disk")
    }
}

/// The directory, ours while this value lives.
#[derive(Debug)]
pub struct DataDir {
    path: PathBuf,
    disk: Disk,
    /// The lock goes with the file when it is closed.
    _lock: File,
}

impl DataDir {
    /// Makes the directory if need be and takes possession of it.
    ///
    /// # Errors
    /// When another server has it, or it cannot be made or written.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        Self::open_on(path, Disk::default())
    }

    /// The same on a disk that may be a test's.
    ///
    /// # Errors
    /// As [`DataDir::open`].
    pub fn open_on(path: &Path, disk: Disk) -> Result<Self, DataError> {
        let at = |path: &Path| {
            let path = path.to_owned();
            move |cause| DataError::Io { path, cause }
        };
        make_private(path).map_err(at(path))?;
        let lock_path = path.join("lock");
        let lock = File::options()
            .create(true)
            .write(true)
            .truncate(false)
            .open(&lock_path)
            .map_err(at(&lock_path))?;
        match lock.try_lock() {
            Ok(()) => Ok(Self {
                path: path.to_owned(),
                disk,
                _lock: lock,
            }),
            Err(TryLockError::WouldBlock) => Err(DataError::InUse(path.to_owned())),
            Err(TryLockError::Error(cause)) => Err(at(&lock_path)(cause)),
        }
    }

    /// What its files are on.
    pub const fn disk(&self) -> &Disk {
        &self.disk
    }

    /// Where the file `name` is.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The file `name` does not hold what it must.
    pub fn damaged(&self, name: &str, text: &'static str) -> DataError {
        let path = self.file(name);
        DataError::Damaged { path, text }
    }

    /// An error of the file `name`.
    pub fn failed(&self, name: &str, cause: io::Error) -> DataError {
        let path = self.file(name);
        DataError::Io { path, cause }
    }

    /// Reads the number in the file `name`; `None` when there is no such file.
    ///
    /// # Errors
    /// When it cannot be read or is not a number.
    pub fn number(&self, name: &str) -> Result<Option<u64>, DataError> {
        let path = self.path.join(name);
        match fs::read_to_string(&path) {
            Ok(text) => text
                .trim()
                .parse()
                .map(Some)
                .map_err(|_| DataError::Damaged {
                    path,
                    text: "is not a number; remove the file to start afresh",
                }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(cause) => Err(DataError::Io { path, cause }),
        }
    }

    /// Writes the number in the file `name`, whole or not at all.
    ///
    /// # Errors
    /// What the disk says.
    pub fn set_number(&self, name: &str, number: u64) -> Result<(), DataError> {
        let path = self.path.join(name);
        let new = self.path.join(format!("{name}.new"));
        let write = || -> io::Result<()> {
            let mut file = File::create(&new)?;
            writeln!(file, "{number}")?;
            self.disk.sync_all(&file)?;
            fs::rename(&new, &path)?;
            // Or a power cut can bring the old name back, and with it the old number.
            self.disk.sync_all(&File::open(&self.path)?)
        };
        write().map_err(|cause| DataError::Io {
            path: path.clone(),
            cause,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("crawler-data-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        path
    }

    #[test]
    fn a_number_survives() {
        let path = scratch("number");
        let data = DataDir::open(&path).expect("open");
        assert_eq!(data.number("seq").expect("read"), None);
        data.set_number("seq", 17).expect("write");
        data.set_number("seq", 18).expect("write again");
        drop(data);
        let data = DataDir::open(&path).expect("open again");
        assert_eq!(data.number("seq").expect("read"), Some(18));
        fs::remove_dir_all(path).expect("clean up");
    }

    #[test]
    fn one_server_at_a_time() {
        let path = scratch("lock");
        let first = DataDir::open(&path).expect("open");
        let second = DataDir::open(&path).expect_err("in use");
        assert!(matches!(second, DataError::InUse(_)), "{second}");
        drop(first);
        DataDir::open(&path).expect("free again");
        fs::remove_dir_all(path).expect("clean up");
    }

    #[test]
    fn damage_is_named() {
        let path = scratch("damage");
        let data = DataDir::open(&path).expect("open");
        fs::write(path.join("seq"), "seventeen").expect("write");
        let error = data.number("seq").expect_err("damaged").to_string();
        assert!(error.contains("seq: is not a number"), "{error}");
        fs::remove_dir_all(path).expect("clean up");
    }
}
