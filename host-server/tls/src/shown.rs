//! The certificates that the options name, looked at without making any.

use std::path::PathBuf;

use crate::certificates::{CertificateOptions, Certificates};
use crate::error::TlsError;
use crate::files;

/// A certificate of this server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shown {
    /// Its file.
    pub path: PathBuf,
    /// Its last moment, in Unix seconds; `None` when it is not there yet.
    pub until: Option<i64>,
    /// Whether the server makes and renews it itself.
    pub own: bool,
}

impl Certificates {
    /// What the listeners would show; nothing when none of them speaks TLS. `now` is in Unix seconds.
    ///
    /// # Errors
    /// [`TlsError`] says which file is wrong, and what about it.
    pub fn shown(options: &CertificateOptions, now: i64) -> Result<Option<Shown>, TlsError> {
        if options.listeners.is_empty() {
            return Ok(None);
        }
        let dir = &options.dir;
        let (path, key, own) = match &options.own {
            Some((certificate, key)) => (certificate.clone(), key.clone(), false),
            None => (dir.join("server.pem"), dir.join("server.key"), true),
        };
        if own && !path.exists() && !dir.join("ca.pem").exists() {
            return Ok(Some(Shown {
                path,
                until: None,
                own,
            }));
        }
        if own {
            // Without the authority the server does not start.
            files::pair(&dir.join("ca.pem"), &dir.join("ca.key"))?;
        }
        let (_, validity) = files::pair(&path, &key)?;
        files::check_time(&path, validity, now)?;
        Ok(Some(Shown {
            path,
            until: Some(validity.until),
            own,
        }))
    }
}
