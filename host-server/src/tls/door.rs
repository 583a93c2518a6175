//! The way in: a handshake that takes a bounded time, of a bounded number at once.
//!
//! A handshake costs the server more than the client. What waits for one is bounded in total, and
//! for each address on its own, so that one machine that opens connections and says nothing does not
//! keep out the others.

use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

use crate::places::Places;

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
    doorway: Arc<Places>,
    time_out: Duration,
}

impl Door {
    pub(crate) fn new(acceptor: TlsAcceptor) -> Self {
        Self {
            acceptor,
            doorway: Places::new(MOST, MOST_OF_ONE),
            time_out: TIME_OUT,
        }
    }

    /// Shakes hands.
    pub(crate) async fn enter(
        &self,
        tcp: TcpStream,
        from: IpAddr,
    ) -> Result<TlsStream<TcpStream>, Refusal> {
        let Some(_place) = self.doorway.take(from) else {
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
