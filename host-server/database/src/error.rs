//! What can go wrong, by what to do about it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use sqlx::postgres::PgDatabaseError;

/// For each call to a database elsewhere, whatever it waits for.
pub const PATIENCE: Duration = Duration::from_secs(5);

/// Why records could not be read or kept. Nothing was changed when a call returns one of these; only
/// after [`RecordsError::Unavailable`] it may have been, as when a connection breaks before the answer.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum RecordsError {
    /// There is one of that name already.
    Exists,
    /// There is none of that name.
    NotFound,
    /// Afterwards nobody could administer the server.
    LastAdmin,
    /// What was handed in is too long or not well formed; the text says which and how.
    Invalid(&'static str),
    /// There are as many as may be kept: delete some first. The text says of what.
    TooMany(&'static str),
    /// Somebody has the directory open: stop that process first.
    InUse(PathBuf),
    /// Written by a newer program: use that one, or restore a backup.
    Newer {
        /// The file, or the address of the database.
        file: PathBuf,
        /// Version of its tables.
        found: i64,
        /// The newest version that this program knows.
        known: i64,
    },
    /// Not a file, or a database, of this program.
    Foreign(PathBuf),
    /// The file, or the database, is damaged: restore a backup.
    Damaged {
        /// The file, or the address of the database.
        file: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The database does not answer, or is too busy: the same call may work in a moment. The text says
    /// what happened.
    Unavailable(String),
    /// The database answers, and lets nobody in: the text says why and what to do.
    Refused(String),
    /// The records were closed.
    Closed,
    /// The operating system refused.
    Io {
        /// What was to be read or written.
        path: PathBuf,
        /// What it said.
        cause: Arc<std::io::Error>,
    },
    /// The database refused: disk full, locked for too long, or not readable.
    Storage(Arc<sqlx::Error>),
}

impl RecordsError {
    /// The operating system refused to read or write `path`.
    #[must_use]
    pub fn io(path: &Path, cause: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            cause: Arc::new(cause),
        }
    }

    /// What is wrong with `file`.
    #[must_use]
    pub fn damaged(file: &Path, why: impl Into<String>) -> Self {
        Self::Damaged {
            file: file.to_owned(),
            why: why.into(),
        }
    }

    /// Nothing came back within [`PATIENCE`].
    #[must_use]
    pub fn late() -> Self {
        Self::Unavailable(format!("no answer within {} s", PATIENCE.as_secs()))
    }

    /// Whether the same call may work in a moment.
    #[must_use]
    pub const fn is_passing(&self) -> bool {
        matches!(self, Self::Unavailable(_) | Self::InUse(_))
    }

    /// The primary result code of `SQLite`, if it is what refused.
    pub fn sqlite_code(&self) -> Option<i32> {
        let Self::Storage(cause) = self else {
            return None;
        };
        let code = cause.as_database_error()?.code()?;
        // Extended codes carry the primary one in their low byte.
        Some(code.parse::<i32>().ok()? & 0xff)
    }
}

impl fmt::Display for RecordsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exists => f.write_str("there is one of that name already"),
            Self::NotFound => f.write_str("there is none of that name"),
            Self::LastAdmin => f.write_str("this is the last administrator"),
            Self::Invalid(what) => f.write_str(what),
            Self::TooMany(what) => write!(f, "too many {what}: delete some first"),
            Self::InUse(path) => write!(f, "{} is in use by another process", path.display()),
            Self::Newer { file, found, known } => write!(
                f,
                "{} was written by a newer version (tables {found}, this program knows {known})",
                file.display()
            ),
            Self::Foreign(file) => {
                write!(f, "{} is not of this program", file.display())
            }
            Self::Damaged { file, why } => {
                write!(f, "{} is damaged ({why}): restore a backup", file.display())
            }
            Self::Unavailable(why) => write!(f, "the database is not available: {why}"),
            Self::Refused(why) => f.write_str(why),
            Self::Closed => f.write_str("the records were closed"),
            Self::Io { path, cause } => write!(f, "{}: {cause}", path.display()),
            Self::Storage(cause) => write!(f, "the records cannot be read or written: {cause}"),
        }
    }
}

impl std::error::Error for RecordsError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { cause, .. } => Some(&**cause),
            Self::Storage(cause) => Some(&**cause),
            _ => None,
        }
    }
}

impl From<sqlx::Error> for RecordsError {
    fn from(cause: sqlx::Error) -> Self {
        match &cause {
            sqlx::Error::Io(_) | sqlx::Error::Protocol(_) => Self::Unavailable(cause.to_string()),
            sqlx::Error::PoolTimedOut => Self::late(),
            sqlx::Error::PoolClosed => Self::Closed,
            sqlx::Error::Database(error) if passes(&**error) => {
                Self::Unavailable(error.message().to_owned())
            }
            _ => Self::Storage(Arc::new(cause)),
        }
    }
}

/// Whether `PostgreSQL` may say something else in a moment (its documentation, appendix A).
fn passes(error: &dyn sqlx::error::DatabaseError) -> bool {
    let Some(error) = error.try_downcast_ref::<PgDatabaseError>() else {
        return false;
    };
    let code = error.code();
    // A broken connection; too few resources; shut down, or starting.
    ["08", "53", "57P"].iter().any(|class| code.starts_with(class))
        // Serialisation, deadlock, waited too long: for a lock, a statement, a transaction.
        || ["40001", "40P01", "55P03", "57014", "25P03"].contains(&code)
}
