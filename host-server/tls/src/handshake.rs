//! The way in: a handshake that takes a bounded time.
//!
//! A handshake costs the server more than the client. How many wait for one at once is for the listener to
//! bound: see `crawler_system::waiting`.

use std::io;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

/// For the whole handshake.
const TIME_OUT: Duration = Duration::from_secs(10);
/// The first byte of every TLS connection (RFC 8446, section 5.1: handshake).
const HANDSHAKE: u8 = 22;

/// Why somebody does not get in.
#[derive(Debug)]
pub enum Refusal {
    /// They do not speak TLS.
    Plain(TcpStream),
    /// They went away before they said anything.
    Gone,
    /// They took too long.
    Late,
    /// The handshake failed.
    Failed(io::Error),
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Plain(_) => f.write_str("it does not speak TLS"),
            Self::Gone => f.write_str("it went away"),
            Self::Late => f.write_str("it took too long"),
            Self::Failed(error) => error.fmt(f),
        }
    }
}

/// Where encrypted connections come in.
pub struct TlsHandshake {
    acceptor: TlsAcceptor,
    time_out: Duration,
}

impl TlsHandshake {
    /// One with the usual time for the whole handshake.
    pub fn new(acceptor: TlsAcceptor) -> Self {
        Self {
            acceptor,
            time_out: TIME_OUT,
        }
    }

    /// The same with another time for the whole handshake.
    #[must_use]
    pub fn within(self, time_out: Duration) -> Self {
        Self { time_out, ..self }
    }

    /// Shakes hands.
    ///
    /// # Errors
    /// [`Refusal`] says why somebody does not get in.
    pub async fn enter(&self, tcp: TcpStream) -> Result<TlsStream<TcpStream>, Refusal> {
        let entering = async {
            let mut first = [0];
            match tcp.peek(&mut first).await {
                Ok(0) => Err(Refusal::Gone),
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
