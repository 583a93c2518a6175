//! The way to an outside broker with TLS.
//!
//! Neither the server's MQTT client nor simulated robots encrypt anything themselves. They connect to
//! a port of this process on loopback, and everything that arrives there is carried to the broker
//! over a TLS connection of its own, once the broker has shown a certificate that is trusted under
//! the name it was called by.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::{CancellationToken, DropGuard};
use tokio_util::task::TaskTracker;

use crate::carry::carry;
use crate::client::{ConnectError, TlsClient};
use crate::time::unix_now;
use crawler_system::address::BrokerUrl;

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
    /// [`ConnectError`]
    pub async fn open(url: &BrokerUrl, ca: Option<&Path>) -> Result<Self, ConnectError> {
        let far = Arc::new(Far::new(url, ca)?);
        // Later failures only end connections, which tells those who wait for an answer nothing.
        drop(far.client.connect().await?);
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
            .await
            .map_err(ConnectError::Io)?;
        let inside = listener.local_addr().map_err(ConnectError::Io)?;
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
    client: TlsClient,
    complained: AtomicI64,
}

impl Far {
    fn new(url: &BrokerUrl, ca: Option<&Path>) -> Result<Self, ConnectError> {
        Ok(Self {
            client: TlsClient::new(&url.host, url.port, ca, "--broker-ca")?,
            complained: AtomicI64::new(0),
        })
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
            match far.client.connect().await {
                Ok(broker) => carry(near, broker).await,
                Err(error) => {
                    far.complain(&error.to_string());
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
