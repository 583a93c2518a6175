//! TLS beneath whatever opens streams.

use core::ops::DerefMut;

use crawler_hal::{NetError, Network};
use embedded_io_async::{ErrorType, Read, Write};
use rand_core::CryptoRng;

use crate::authority::Authority;
use crate::connection::Buffers;
use crate::error::TlsError;
use crate::expected::Expected;
use crate::stream::{StreamError, TlsStream};

/// What a connection is secured with.
#[derive(Debug)]
pub struct Security<R, B, T> {
    /// Who has to have signed the certificates of servers.
    pub authority: Authority,
    /// Randomness that nobody can guess.
    pub rng: R,
    /// Memory of the connection.
    pub buffers: B,
    /// Tells the seconds since 1970, once they are known.
    pub clock: T,
}

/// A network whose streams are encrypted when there is [`Security`], and as they are otherwise.
/// With it nothing is ever said in the clear.
#[derive(Debug)]
pub struct Secured<N, R, B, T> {
    network: N,
    security: Option<Security<R, B, T>>,
}

impl<N, R, B, T> Secured<N, R, B, T> {
    /// Puts `security`, if any, over `network`.
    pub const fn new(network: N, security: Option<Security<R, B, T>>) -> Self {
        Self { network, security }
    }
}

impl<N, R, B, T> Network for Secured<N, R, B, T>
where
    N: Network,
    R: CryptoRng,
    B: DerefMut<Target = Buffers>,
    T: Fn() -> Option<u64>,
{
    type Stream<'a>
        = SecuredStream<'a, N::Stream<'a>>
    where
        Self: 'a;
    type Monitor = N::Monitor;

    fn monitor(&self) -> N::Monitor {
        self.network.monitor()
    }

    async fn join(&mut self) -> Result<(), NetError> {
        self.network.join().await
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<Self::Stream<'_>, NetError> {
        let stream = self.network.connect(host, port).await?;
        let Some(security) = &mut self.security else {
            return Ok(SecuredStream::Plain(stream));
        };
        let expected = Expected {
            host,
            authority: security.authority,
            now: (security.clock)(),
        };
        TlsStream::open(stream, &mut security.buffers, &expected, &mut security.rng)
            .await
            .map(SecuredStream::Tls)
            .map_err(|error| match error {
                StreamError::Stream(_) | StreamError::Tls(TlsError::Closed) => NetError::Refused,
                StreamError::Tls(error) => NetError::Insecure(error.reason()),
            })
    }
}

/// A stream of a [`Secured`] network.
// The larger one is what is meant to be there.
#[allow(clippy::large_enum_variant)]
#[derive(Debug)]
pub enum SecuredStream<'b, S> {
    /// As it is beneath.
    Plain(S),
    /// Encrypted.
    Tls(TlsStream<'b, S>),
}

impl<S: ErrorType> ErrorType for SecuredStream<'_, S> {
    type Error = StreamError<S::Error>;
}

impl<S: Read + Write> Read for SecuredStream<'_, S> {
    /// # Cancellation Safety
    /// As the stream beneath, whose bytes are kept where they do not make a record yet.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Self::Error> {
        match self {
            Self::Plain(stream) => stream.read(buf).await.map_err(StreamError::Stream),
            Self::Tls(stream) => stream.read(buf).await,
        }
    }
}

impl<S: Read + Write> Write for SecuredStream<'_, S> {
    /// # Cancellation Safety
    /// As the stream beneath; encrypted, a dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Self::Error> {
        match self {
            Self::Plain(stream) => stream.write(buf).await.map_err(StreamError::Stream),
            Self::Tls(stream) => stream.write(buf).await,
        }
    }

    async fn flush(&mut self) -> Result<(), Self::Error> {
        match self {
            Self::Plain(stream) => stream.flush().await.map_err(StreamError::Stream),
            Self::Tls(stream) => stream.flush().await,
        }
    }
}
