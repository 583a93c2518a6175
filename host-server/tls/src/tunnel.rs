//! The way to an outside broker with TLS.
//!
//! Neither the server's MQTT client nor simulated robots encrypt anything themselves. They connect to
//! a port of this process on loopback, and everything that arrives there is carried to the broker
//! over a TLS connection of its own, once the broker has shown a certificate that is trusted under
//! the name it was called by.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{CertificateError, ClientConfig, Error, RootCertStore};
use tokio_util::sync::{CancellationToken, DropGuard};
use tokio_util::task::TaskTracker;

use crate::carry::carry;
use crate::{files, provider, unix_now};
use crawler_system::address::BrokerUrl;

/// For connecting and the handshake.
const TIME_OUT: Duration = Duration::from_secs(10);
/// Connections at a time: those of the largest simulated fleet, twice.
const MOST: usize = 25_000;
/// A broker that is away is worth one line in so many seconds, whoever asks for it.
const SILENCE: i64 = 10;

/// A way to one broker, until it is dropped.
pub struct Tunnel {
    inside: BrokerUrl,
    connections: TaskTracker,
    stop: DropGuard,
}

impl Tunnel {
    /// Opens a way to the broker at `url`, once it has shown that it is trusted: by the authorities
    /// in `ca`, or else by those that this machine trusts.
    ///
    /// # Errors
    /// One line saying what is wrong.
    pub async fn open(url: &BrokerUrl, ca: Option<&Path>) -> Result<Self, String> {
        let far = Arc::new(Far::new(url, ca)?);
        // Later failures only end connections, which tells those who wait for an answer nothing.
        drop(far.connect().await?);
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
            .await
            .map_err(|error| error.to_string())?;
        let inside = listener.local_addr().map_err(|error| error.to_string())?;
        let stop = CancellationToken::new();
        let connections = TaskTracker::new();
        connections.spawn(serve(listener, far, connections.clone(), stop.clone()));
        Ok(Self {
            inside: BrokerUrl {
                host: inside.ip().to_string(),
                port: inside.port(),
                credentials: url.credentials.clone(),
                tls: false,
            },
            connections,
            stop: stop.drop_guard(),
        })
    }

    /// Ends every connection and frees the port.
    pub async fn stop(self) {
        let Self {
            connections, stop, ..
        } = self;
        drop(stop);
        connections.close();
        connections.wait().await;
    }

    /// Where the broker is reached without TLS, from this machine alone.
    pub const fn inside(&self) -> &BrokerUrl {
        &self.inside
    }
}

/// The far end.
struct Far {
    host: String,
    port: u16,
    name: ServerName<'static>,
    connector: TlsConnector,
    complained: AtomicI64,
}

impl Far {
    fn new(url: &BrokerUrl, ca: Option<&Path>) -> Result<Self, String> {
        let roots = match ca {
            Some(path) => files::authorities(path).map_err(|error| error.to_string())?,
            None => of_this_machine()?,
        };
        let config = ClientConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .map_err(|error| error.to_string())?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let name = ServerName::try_from(url.host.clone())
            .map_err(|_| format!("no certificate can be for the host name {}", url.host))?;
        Ok(Self {
            host: url.host.clone(),
            port: url.port,
            name,
            connector: TlsConnector::from(Arc::new(config)),
            complained: AtomicI64::new(0),
        })
    }

    async fn connect(&self) -> Result<TlsStream<TcpStream>, String> {
        let connecting = async {
            let tcp = TcpStream::connect((self.host.as_str(), self.port)).await?;
            // Only costs latency when it fails.
            let _ = tcp.set_nodelay(true);
            self.connector.connect(self.name.clone(), tcp).await
        };
        match tokio::time::timeout(TIME_OUT, connecting).await {
            Ok(Ok(stream)) => Ok(stream),
            Ok(Err(error)) => Err(describe(&error)),
            Err(_) => Err(format!("no answer within {} s", TIME_OUT.as_secs())),
        }
    }

    fn complain(&self, reason: &str) {
        let now = unix_now();
        let last = self.complained.load(Ordering::Relaxed);
        if now - last >= SILENCE {
            self.complained.store(now, Ordering::Relaxed);
            tracing::warn!(reason, "no TLS connection to the broker");
        }
    }
}

fn of_this_machine() -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    let found = rustls_native_certs::load_native_certs();
    roots.add_parsable_certificates(found.certs);
    if roots.is_empty() {
        return Err(
            "this machine trusts no certificate authority: name one with --broker-ca".into(),
        );
    }
    Ok(roots)
}

/// What is wrong, and what to do about it.
fn describe(error: &io::Error) -> String {
    let tls = error
        .get_ref()
        .and_then(|error| error.downcast_ref::<Error>());
    match tls {
        Some(Error::InvalidCertificate(CertificateError::UnknownIssuer)) => {
            "its certificate is of an authority that is not trusted; name that with --broker-ca"
                .into()
        }
        Some(Error::InvalidCertificate(
            CertificateError::Expired | CertificateError::ExpiredContext { .. },
        )) => "its certificate has expired".into(),
        Some(Error::InvalidCertificate(
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
        )) => "its certificate is for another host name".into(),
        Some(Error::InvalidMessage(_)) => "it does not speak TLS at this port".into(),
        Some(error) => format!("TLS: {error}"),
        None if error.kind() == io::ErrorKind::UnexpectedEof => {
            "it ended the connection; it may not speak TLS at this port".into()
        }
        None => error.to_string(),
    }
}

async fn serve(
    listener: TcpListener,
    far: Arc<Far>,
    connections: TaskTracker,
    stop: CancellationToken,
) {
    let places = Arc::new(Semaphore::new(MOST));
    loop {
        let accepting = async {
            let place = Arc::clone(&places).acquire_owned().await;
            (place, listener.accept().await)
        };
        let Some((Ok(place), accepted)) = stop.run_until_cancelled(accepting).await else {
            return;
        };
        let near = match accepted {
            Ok((near, _)) => near,
            Err(error) => {
                far.complain(&error.to_string());
                tokio::time::sleep(Duration::from_millis(200)).await;
                continue;
            }
        };
        let far = Arc::clone(&far);
        let carrying = async move {
            let _ = near.set_nodelay(true);
            match far.connect().await {
                Ok(broker) => carry(near, broker).await,
                Err(reason) => {
                    far.complain(&reason);
                    // Clients hear of it as of a broker that is not there.
                    let _ = near.set_zero_linger();
                }
            }
            drop(place);
        };
        let stop = stop.clone();
        connections.spawn(async move {
            stop.run_until_cancelled(carrying).await;
        });
    }
}

/// Where a listener of this process is reached from here.
pub fn reachable(listener: SocketAddr) -> SocketAddr {
    let ip = match listener.ip() {
        ip if !ip.is_unspecified() => ip,
        std::net::IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
        std::net::IpAddr::V6(_) => std::net::Ipv6Addr::LOCALHOST.into(),
    };
    SocketAddr::new(ip, listener.port())
}
