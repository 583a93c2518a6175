//! TLS in front of the embedded broker.
//!
//! The broker's library can serve TLS itself, but reads its certificate once, and only with a second
//! provider of cryptography that is built from C. So the broker listens on loopback, and what
//! arrives here is decrypted and carried there. Who it came from is kept in [`Peers`]: to the broker
//! every such client would be this machine.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;

use super::carry::carry;
use super::door::Door;

/// Connections at a time; as many as the broker takes. Others wait in the system's queue.
const MOST: usize = 25_000;

/// Whom the connections that come through the front belong to, by the address that the broker
/// sees.
#[derive(Debug, Default)]
pub(crate) struct Peers(Mutex<HashMap<SocketAddr, SocketAddr>>);

impl Peers {
    /// Where a connection really came from.
    pub(crate) fn origin(&self, seen: SocketAddr) -> SocketAddr {
        let peers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        peers.get(&seen).copied().unwrap_or(seen)
    }

    /// Notes where a connection comes from that the broker sees at `seen`.
    pub(crate) fn note(self: &Arc<Self>, seen: SocketAddr, origin: SocketAddr) -> Note {
        let mut peers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        peers.insert(seen, origin);
        Note {
            peers: Arc::clone(self),
            seen,
        }
    }
}

/// What is noted of a connection, until it is dropped.
pub(crate) struct Note {
    peers: Arc<Peers>,
    seen: SocketAddr,
}

impl Drop for Note {
    fn drop(&mut self) {
        let mut peers = self.peers.0.lock().unwrap_or_else(PoisonError::into_inner);
        peers.remove(&self.seen);
    }
}

/// The listener in front of the broker.
pub(crate) struct Front {
    address: SocketAddr,
}

impl Front {
    /// Listens at `listen` and carries what comes through `door` to the broker at `to`, in the
    /// runtime of the broker: it ends with that.
    ///
    /// # Errors
    /// What the operating system says when the address cannot be bound.
    pub(crate) async fn start(
        listen: SocketAddr,
        to: SocketAddr,
        door: Door,
        peers: Arc<Peers>,
        runtime: &Handle,
    ) -> std::io::Result<Self> {
        let bind = runtime.spawn(TcpListener::bind(listen));
        let listener = bind.await.map_err(std::io::Error::other)??;
        let address = listener.local_addr()?;
        runtime.spawn(serve(listener, to, Arc::new(door), peers));
        Ok(Self { address })
    }

    /// The address it listens at, with the port chosen by the system when none was asked for.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }
}

async fn serve(listener: TcpListener, to: SocketAddr, door: Arc<Door>, peers: Arc<Peers>) {
    let places = Arc::new(Semaphore::new(MOST));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        let (client, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                // Out of file descriptors, most likely: trying at once would only burn time.
                tracing::warn!(%error, "cannot accept a connection to the broker");
                tokio::time::sleep(Duration::from_millis(200)).await;
                continue;
            }
        };
        let (door, peers) = (Arc::clone(&door), Arc::clone(&peers));
        tokio::spawn(async move {
            // Only costs latency when it fails.
            let _ = client.set_nodelay(true);
            match door.enter(client, from.ip()).await {
                Ok(client) => match TcpStream::connect(to).await {
                    Ok(broker) => {
                        let _ = broker.set_nodelay(true);
                        // Before the first byte: the broker asks with the first packet.
                        let _note = broker.local_addr().map(|seen| peers.note(seen, from));
                        carry(client, broker).await;
                    }
                    Err(error) => tracing::warn!(%error, "the broker takes no connection"),
                },
                Err(refusal) => tracing::debug!(%from, %refusal, "a client did not get in"),
            }
            drop(place);
        });
    }
}
