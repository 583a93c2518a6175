//! The protocol over an asynchronous byte stream.

use core::fmt;

use embassy_futures::yield_now;
use embedded_io_async::{Error, ErrorKind, ErrorType, Read, Write};
use rand_core::CryptoRng;

use crate::connection::{Buffers, Connection, Step};
use crate::error::TlsError;
use crate::expected::Expected;

/// What went wrong: with the stream, or with TLS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamError<E> {
    /// What the stream said.
    Stream(E),
    /// What is wrong with what came through it.
    Tls(TlsError),
}

impl<E> From<TlsError> for StreamError<E> {
    fn from(error: TlsError) -> Self {
        Self::Tls(error)
    }
}

impl<E: fmt::Display> fmt::Display for StreamError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stream(error) => error.fmt(f),
            Self::Tls(error) => error.fmt(f),
        }
    }
}

impl<E: core::error::Error> core::error::Error for StreamError<E> {}

impl<E: Error> Error for StreamError<E> {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Stream(error) => error.kind(),
            // Whoever holds the line can end it: that is no more than a broken one.
            Self::Tls(TlsError::Closed) => ErrorKind::ConnectionAborted,
            Self::Tls(TlsError::Alert(_)) => ErrorKind::ConnectionReset,
            Self::Tls(_) => ErrorKind::InvalidData,
        }
    }
}

/// A byte stream, encrypted. Dropping it drops the stream beneath, without a good-bye.
#[derive(Debug)]
pub struct TlsStream<'b, S> {
    stream: S,
    connection: Connection<'b>,
}

impl<'b, S: Read + Write> TlsStream<'b, S> {
    /// Shakes hands over `stream`. Between heavy computations others get their turn.
    ///
    /// # Errors
    /// [`StreamError`]; an alert has been handed to the stream then, in as far as it took it.
    ///
    /// # Cancellation Safety
    /// A dropped call drops the stream. It has no deadline of its own: give it one.
    pub async fn open(
        stream: S,
        buffers: &'b mut Buffers,
        expected: &Expected<'_>,
        rng: &mut impl CryptoRng,
    ) -> Result<Self, StreamError<S::Error>> {
        let connection = Connection::start(buffers, expected, rng)?;
        let mut this = Self { stream, connection };
        yield_now().await;
        while !this.connection.is_open() {
            this.drain().await?;
            match this.connection.shake(expected) {
                Ok(Step::Hungry) => this.feed().await?,
                Ok(_) => yield_now().await,
                Err(error) => {
                    // Only a courtesy.
                    let _ = this.flush().await;
                    return Err(error.into());
                }
            }
        }
        this.flush().await?;
        Ok(this)
    }

    /// Writes what is pending.
    ///
    /// # Cancellation Safety
    /// Nothing is written twice or left out.
    async fn drain(&mut self) -> Result<(), StreamError<S::Error>> {
        while !self.connection.pending().is_empty() {
            let written = self.stream.write(self.connection.pending()).await;
            match written.map_err(StreamError::Stream)? {
                0 => return Err(TlsError::Closed.into()),
                count => self.connection.sent(count),
            }
        }
        Ok(())
    }

    /// Reads some of the record under way.
    ///
    /// # Cancellation Safety
    /// As the stream's own: what is read is kept.
    async fn feed(&mut self) -> Result<(), StreamError<S::Error>> {
        let space = self.connection.space()?;
        match self.stream.read(space).await.map_err(StreamError::Stream)? {
            0 => Err(TlsError::Closed.into()),
            count => {
                self.connection.received(count);
                Ok(())
            }
        }
    }
}

impl<S: ErrorType> ErrorType for TlsStream<'_, S> {
    type Error = StreamError<S::Error>;
}

impl<S: Read + Write> Read for TlsStream<'_, S> {
    /// Ends with 0 only after the server has said good-bye.
    ///
    /// # Cancellation Safety
    /// A dropped call takes no byte: what has arrived of a record is kept for the next call.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Self::Error> {
        if buf.is_empty() {
            return Ok(0);
        }
        loop {
            match self.connection.step()? {
                Step::Ended => return Ok(0),
                Step::Worked => {}
                Step::Hungry => self.feed().await?,
                Step::Data => {
                    let data = self.connection.plaintext();
                    let count = data.len().min(buf.len());
                    for (to, from) in buf.iter_mut().zip(data) {
                        *to = *from;
                    }
                    self.connection.consume(count);
                    return Ok(count);
                }
            }
        }
    }
}

impl<S: Read + Write> Write for TlsStream<'_, S> {
    /// Encrypts into a record, which leaves with the next call or with [`Write::flush`].
    ///
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Self::Error> {
        self.drain().await?;
        Ok(self.connection.say(buf)?)
    }

    /// # Cancellation Safety
    /// What is left leaves with the next call.
    async fn flush(&mut self) -> Result<(), Self::Error> {
        self.drain().await?;
        self.stream.flush().await.map_err(StreamError::Stream)
    }
}
