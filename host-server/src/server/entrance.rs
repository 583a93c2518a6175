//! Where clients of the API come in.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::net::TcpListener;

use super::StartError;
use crate::config::{DEFAULT_ROBOTS, Role, Settings};
use crawler_server_tls::{Certificates, TlsHandshake};
use crawler_system::descriptors::Descriptors;

/// Where clients of the API come in, and how many.
pub(super) struct Entrance {
    pub(super) certificates: Option<Arc<Certificates>>,
    pub(super) descriptors: Descriptors,
    pub(super) listener: TcpListener,
    pub(super) http: SocketAddr,
    pub(super) tls: Option<TlsHandshake>,
}

impl Entrance {
    pub(super) async fn open(settings: &Settings) -> Result<Self, StartError> {
        let certificates = Certificates::of(&settings.certificates())?;
        let descriptors = Descriptors::of_process(match settings.role {
            Role::Up => settings.robots.unwrap_or(DEFAULT_ROBOTS),
            Role::Serve | Role::Sim | Role::Worker => 0,
        });
        let listener = TcpListener::bind(settings.http)
            .await
            .map_err(|cause| StartError::http(settings.http, cause))?;
        let http = listener
            .local_addr()
            .map_err(|cause| StartError::http(settings.http, cause))?;
        let tls = match &certificates {
            Some(certificates) if settings.tls.covers(settings.http) => {
                Some(TlsHandshake::new(certificates.acceptor(b"http/1.1", None)?))
            }
            _ => None,
        };
        Ok(Self {
            certificates,
            descriptors,
            listener,
            http,
            tls,
        })
    }

    /// The certificate that clients pin.
    pub(super) fn authority(&self) -> Option<PathBuf> {
        self.certificates.as_ref().and_then(|own| own.authority())
    }
}
