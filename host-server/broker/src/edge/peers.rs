//! Where connections really come from.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Whom the connections to the broker belong to, by the address that it sees.
#[derive(Debug, Default)]
pub(crate) struct Peers(Mutex<HashMap<SocketAddr, SocketAddr>>);

impl Peers {
    /// Where a connection really came from.
    pub(crate) fn origin(&self, seen: SocketAddr) -> SocketAddr {
        let peers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        peers.get(&seen).copied().unwrap_or(seen)
    }

    /// Notes where a connection comes from that the broker sees at `seen`.
    pub(super) fn note(self: &Arc<Self>, seen: SocketAddr, origin: SocketAddr) -> Note {
        let mut peers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        peers.insert(seen, origin);
        Note {
            peers: Arc::clone(self),
            seen,
        }
    }
}

/// What is noted of a connection, until it is dropped.
pub(super) struct Note {
    peers: Arc<Peers>,
    seen: SocketAddr,
}

impl Drop for Note {
    fn drop(&mut self) {
        let mut peers = self.peers.0.lock().unwrap_or_else(PoisonError::into_inner);
        peers.remove(&self.seen);
    }
}
