//! Why there is no TLS.

use std::fmt;
use std::io;
use std::path::PathBuf;

/// Why certificates or keys cannot be used.
#[derive(Debug)]
#[non_exhaustive]
pub enum TlsError {
    /// A file cannot be read or written.
    File {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        cause: io::Error,
    },
    /// A file does not hold what it should.
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        text: String,
    },
    /// The private key is another certificate's.
    Mismatch {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
    },
    /// A certificate is no longer valid, or not yet.
    Time {
        /// The certificate.
        path: PathBuf,
        /// Since when, or from when on.
        text: String,
    },
    /// Half of the private authority is missing.
    Half {
        /// What is missing.
        missing: PathBuf,
        /// What is there.
        there: PathBuf,
    },
    /// A certificate cannot be made.
    Make(String),
}

impl From<rcgen::Error> for TlsError {
    fn from(error: rcgen::Error) -> Self {
        Self::Make(error.to_string())
    }
}

impl fmt::Display for TlsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { path, cause } => write!(f, "TLS: {}: {cause}", path.display()),
            Self::Content { path, text } => write!(f, "TLS: {}: {text}", path.display()),
            Self::Mismatch { certificate, key } => write!(
                f,
                "TLS: the key in {} is not that of the certificate in {}",
                key.display(),
                certificate.display()
            ),
            Self::Time { path, text } => write!(
                f,
                "TLS: the certificate in {} {text}; the clock of this machine may be wrong, too",
                path.display()
            ),
            Self::Half { missing, there } => write!(
                f,
                "TLS: {} is missing while {} is there; restore it from a backup, or remove both \
                 and give every client the new ca.pem",
                missing.display(),
                there.display()
            ),
            Self::Make(text) => write!(f, "TLS: cannot make a certificate: {text}"),
        }
    }
}

impl std::error::Error for TlsError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::File { cause, .. } => Some(cause),
            _ => None,
        }
    }
}
