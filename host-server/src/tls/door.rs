//! The way in: a handshake that takes a bounded time, of a bounded number at once.
//!
//! A handshake costs the server more than the client. What waits for one is bounded in total, and
//! for each address on its own, so that one machine that opens connections and says nothing does not
//! keep out the others.

use std::collections::HashMap;
use std::io;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crawler_access::limits::neighbourhood;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

/// For the whole handshake.
pub(crate) const TIME_OUT: Duration = Duration::from_secs(10);
/// Handshakes at once.
const MOST: usize = 2_048;
/// Handshakes at once with one address. A simulator opens 64 connections at a time.
const MOST_OF_ONE: usize = 256;
/// The first byte of every TLS connection (RFC 8446, section 5.1: handshake).
const HANDSHAKE: u8 = 22;

/// Why somebody does not get in.
#[derive(Debug)]
pub(crate) enum Refusal {
    /// They do not speak TLS.
    Plain(TcpStream),
    /// Too many are in the doorway.
    Crowded,
    /// They took too long.
    Late,
    /// The handshake failed, or they are gone.
    Failed(io::Error),
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Plain(_) => f.write_str("it does not speak TLS"),
            Self::Crowded => f.write_str("too many shake hands already"),
            Self::Late => f.write_str("it took too long"),
            Self::Failed(error) => error.fmt(f),
        }
    }
}

/// Where encrypted connections come in.
pub(crate) struct Door {
    acceptor: TlsAcceptor,
    doorway: Arc<Mutex<HashMap<IpAddr, usize>>>,
    time_out: Duration,
}

impl Door {
    pub(crate) fn new(acceptor: TlsAcceptor) -> Self {
        Self {
            acceptor,
            doorway: Arc::default(),
            time_out: TIME_OUT,
        }
    }

    /// Shakes hands.
    pub(crate) async fn enter(
        &self,
        tcp: TcpStream,
        from: IpAddr,
    ) -> Result<TlsStream<TcpStream>, Refusal> {
        let Some(_place) = Place::take(&self.doorway, from) else {
            return Err(Refusal::Crowded);
        };
        let entering = async {
            let mut first = [0];
            match tcp.peek(&mut first).await {
                Ok(0) => Err(Refusal::Failed(io::ErrorKind::UnexpectedEof.into())),
                Ok(_) if first != [HANDSHAKE] => Err(Refusal::Plain(tcp)),
                Ok(_) => self.acceptor.accept(tcp).await.map_err(Refusal::Failed),
                Err(error) => Err(Refusal::Failed(error)),
            }
        };
        tokio::time::timeout(self.time_out, entering)
            .await
            .unwrap_or(Err(Refusal::Late))
    }
}

/// A place in the doorway.
struct Place {
    doorway: Arc<Mutex<HashMap<IpAddr, usize>>>,
    of: IpAddr,
}

impl Place {
    fn take(doorway: &Arc<Mutex<HashMap<IpAddr, usize>>>, from: IpAddr) -> Option<Self> {
        let of = neighbourhood(from);
        let mut taken = doorway.lock().unwrap_or_else(PoisonError::into_inner);
        // The number of addresses is at most that of places.
        if taken.values().sum::<usize>() >= MOST {
            return None;
        }
        let places = taken.entry(of).or_default();
        if *places >= MOST_OF_ONE {
            return None;
        }
        *places += 1;
        drop(taken);
        Some(Self {
            doorway: Arc::clone(doorway),
            of,
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.doorway.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(places) = taken.get_mut(&self.of) {
            *places -= 1;
            if *places == 0 {
                taken.remove(&self.of);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_does_not_fill_the_doorway() {
        let doorway = Arc::default();
        let hostile: IpAddr = "2001:db8::1".parse().expect("address");
        let neighbour: IpAddr = "2001:db8::2".parse().expect("address");
        let other: IpAddr = "192.0.2.1".parse().expect("address");
        let mut places: Vec<_> = (0..MOST_OF_ONE)
            .map(|_| Place::take(&doorway, hostile).expect("room"))
            .collect();
        assert!(Place::take(&doorway, hostile).is_none());
        assert!(Place::take(&doorway, neighbour).is_none());
        places.push(Place::take(&doorway, other).expect("room for others"));
        places.remove(0);
        assert!(Place::take(&doorway, neighbour).is_some());
        drop(places);
        assert!(doorway.lock().expect("whole").is_empty());
    }

    #[test]
    fn the_doorway_has_an_end() {
        let doorway = Arc::default();
        let places: Vec<_> = (0..MOST as u32)
            .map(|number| {
                let from = std::net::Ipv4Addr::from_bits(number);
                Place::take(&doorway, from.into()).expect("room")
            })
            .collect();
        assert!(Place::take(&doorway, "192.0.2.1".parse().expect("address")).is_none());
        drop(places);
    }
}
