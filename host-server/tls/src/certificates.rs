//! The certificate of this server: made or read, looked after, shown to whoever connects.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, SystemTime};

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::server::{ClientHello, ResolvesServerCert, WebPkiClientVerifier};
use tokio_rustls::rustls::sign::CertifiedKey;
use tokio_util::sync::CancellationToken;

use crate::authority::Authority;
use crate::error::TlsError;
use crate::provider::provider;
use crate::time::unix_now;
use crate::validity::{Validity, day_of};
use crate::{files, names};

/// What clients may ask for by ALPN at the listener of the broker.
pub const MQTT: &[u8] = b"mqtt";
/// Content of a record to a robot, and its overhead.
const ROBOT_FRAGMENT: usize = 2_048;
/// How often files and dates are looked at.
const LOOK: Duration = Duration::from_secs(2);
/// How long a failed renewal is let rest, in seconds.
const AGAIN: i64 = 60;
/// A certificate of the user that ends so soon is worth a word, in seconds.
const SOON: i64 = 14 * 24 * 60 * 60;

/// What a certificate is to be for, and where it comes from.
#[derive(Debug, Clone, Default)]
pub struct CertificateOptions {
    /// Certificate and key of the user: two PEM files. Without them the server has an authority of its own.
    pub own: Option<(PathBuf, PathBuf)>,
    /// More names for the certificate that the server makes.
    pub names: Vec<String>,
    /// Where a private authority lives.
    pub dir: PathBuf,
    /// The listeners that speak TLS.
    pub listeners: Vec<SocketAddr>,
}

/// The certificate of this server, always current.
pub struct Certificates {
    source: Source,
    now: RwLock<Current>,
}

#[derive(Clone)]
struct Current {
    pair: Arc<CertifiedKey>,
    validity: Validity,
}

enum Source {
    /// Made here. When to try again after a renewal that failed.
    Own(Box<Authority>, Mutex<i64>),
    /// Two files that somebody else writes.
    Files {
        certificate: PathBuf,
        key: PathBuf,
        /// How they were when they were read last.
        seen: Mutex<Stamp>,
    },
}

/// What tells that a file was written: time and length of each.
type Stamp = [Option<(SystemTime, u64)>; 2];

fn stamp(certificate: &Path, key: &Path) -> Stamp {
    [certificate, key].map(|path| {
        let data = std::fs::metadata(path).ok()?;
        Some((data.modified().ok()?, data.len()))
    })
}

impl Certificates {
    /// Opens or makes what `options` ask for. `now` is in Unix seconds.
    ///
    /// # Errors
    /// [`TlsError`] says which file is wrong, and what about it.
    pub fn open(options: &CertificateOptions, now: i64) -> Result<Arc<Self>, TlsError> {
        let (source, (pair, validity)) = if let Some((certificate, key)) = &options.own {
            let seen = Mutex::new(stamp(certificate, key));
            let (pair, validity) = files::pair(certificate, key)?;
            files::check_time(certificate, validity, now)?;
            if files::is_public(key) {
                let path = key.display();
                tracing::warn!(%path, "every account of this machine can read this key");
            }
            let source = Source::Files {
                certificate: certificate.clone(),
                key: key.clone(),
                seen,
            };
            (source, (pair, validity))
        } else {
            let names = names::of(&options.listeners, &options.names);
            let authority = Box::new(Authority::open(&options.dir, names, now)?);
            let current = authority.current(now)?;
            (Source::Own(authority, Mutex::new(now)), current)
        };
        if matches!(source, Source::Files { .. }) && now + SOON > validity.until {
            tracing::warn!(
                until = day_of(validity.until),
                "the TLS certificate expires soon"
            );
        }
        Ok(Arc::new(Self {
            source,
            now: RwLock::new(Current { pair, validity }),
        }))
    }

    /// The certificate that the listeners need, if there is one.
    ///
    /// # Errors
    /// [`TlsError`] says which file is wrong, and what about it.
    pub fn of(options: &CertificateOptions) -> Result<Option<Arc<Self>>, TlsError> {
        if options.listeners.is_empty() {
            return Ok(None);
        }
        Self::open(options, unix_now()).map(Some)
    }

    /// The file that clients pin, when the authority is ours.
    pub fn authority(&self) -> Option<PathBuf> {
        match &self.source {
            Source::Own(authority, _) => Some(authority.certificate()),
            Source::Files { .. } => None,
        }
    }

    fn current(&self) -> Current {
        self.now
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn set(&self, (pair, validity): (Arc<CertifiedKey>, Validity)) {
        *self.now.write().unwrap_or_else(PoisonError::into_inner) = Current { pair, validity };
    }

    /// Renews or reads again what is due. Keeps what it has when that fails.
    fn look(&self, now: i64) {
        match &self.source {
            Source::Own(authority, next) => {
                if !Authority::is_due(self.current().validity, now) {
                    return;
                }
                let mut next = next.lock().unwrap_or_else(PoisonError::into_inner);
                if now < *next {
                    return;
                }
                *next = now + AGAIN;
                match authority.issue(now) {
                    Ok(made) => {
                        tracing::info!(until = day_of(made.1.until), "renewed the TLS certificate");
                        self.set(made);
                    }
                    Err(error) => tracing::error!(%error, "the TLS certificate is not renewed"),
                }
            }
            Source::Files {
                certificate,
                key,
                seen,
            } => {
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                let found = stamp(certificate, key);
                if *seen == found {
                    return;
                }
                // Between the writing of one file and the other they do not fit: the second
                // makes another change, and that brings us here again.
                *seen = found;
                let read = files::pair(certificate, key)
                    .and_then(|read| files::check_time(certificate, read.1, now).map(|()| read));
                match read {
                    Ok(read) => {
                        tracing::info!(until = day_of(read.1.until), "a new TLS certificate");
                        self.set(read);
                    }
                    Err(error) => {
                        tracing::error!(%error, "the TLS certificate changed; the old one stays");
                    }
                }
            }
        }
    }

    /// Looks after the certificate until `stop`.
    pub async fn keep(self: Arc<Self>, stop: CancellationToken) {
        let mut tick = tokio::time::interval(LOOK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                _ = tick.tick() => {}
            }
            let looked = Arc::clone(&self);
            // It reads files, and writes them with a sync.
            let looked = tokio::task::spawn_blocking(move || looked.look(unix_now())).await;
            if let Err(error) = looked {
                tracing::error!(%error, "the TLS certificate is not looked after");
            }
        }
    }

    /// What takes connections with this certificate. `protocol` is the name that clients may ask
    /// for by ALPN; `client_ca` holds the authorities of certificates that clients may show.
    ///
    /// # Errors
    /// [`TlsError`] when `client_ca` cannot be used.
    pub fn acceptor(
        self: &Arc<Self>,
        protocol: &[u8],
        client_ca: Option<&Path>,
    ) -> Result<TlsAcceptor, TlsError> {
        let make = |error: &dyn std::fmt::Display| TlsError::Make(error.to_string());
        let config = ServerConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .map_err(|error| make(&error))?;
        let config = match client_ca {
            None => config.with_no_client_auth(),
            Some(path) => {
                let roots = Arc::new(files::authorities(path)?);
                let verifier = WebPkiClientVerifier::builder_with_provider(roots, provider())
                    // Boards of this version have no certificate to show.
                    .allow_unauthenticated()
                    .build()
                    .map_err(|error| make(&error))?;
                config.with_client_cert_verifier(verifier)
            }
        };
        let mut config = config.with_cert_resolver(Arc::clone(self) as _);
        config.alpn_protocols = vec![protocol.to_vec()];
        // Robots have little room for a record, and the extension by which they say so is one that this
        // library does not read.
        config.max_fragment_size = (protocol == MQTT).then_some(ROBOT_FRAGMENT);
        Ok(TlsAcceptor::from(Arc::new(config)))
    }
}

impl std::fmt::Debug for Certificates {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Certificates").finish_non_exhaustive()
    }
}

impl ResolvesServerCert for Certificates {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.current().pair)
    }
}

#[cfg(test)]
mod tests;
