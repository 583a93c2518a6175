//! The certificates that the settings name, looked at without making any.

use std::path::PathBuf;

use super::{Certificates, TlsError, files};
use crate::config::{Broker, Settings};

/// A certificate of this server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Shown {
    /// Its file.
    pub(crate) path: PathBuf,
    /// Its last moment, in Unix seconds; `None` when it is not there yet.
    pub(crate) until: Option<i64>,
    /// Whether the server makes and renews it itself.
    pub(crate) own: bool,
}

impl Certificates {
    /// What the listeners of `settings` would show; nothing when none of them speaks TLS.
    ///
    /// # Errors
    /// [`TlsError`] says which file is wrong, and what about it.
    pub(crate) fn shown(settings: &Settings, now: i64) -> Result<Option<Shown>, TlsError> {
        let mqtt = match settings.broker {
            Broker::Embedded(listen) => settings.tls.covers(listen),
            Broker::Outside(_) => false,
        };
        if !mqtt && !settings.tls.covers(settings.http) {
            return Ok(None);
        }
        let dir = settings.data.join("tls");
        let (path, key, own) = match &settings.tls.own {
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
