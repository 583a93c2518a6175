//! The network of a simulated robot, whichever it is.
//!
//! One type for all of them, so that the program over it is compiled once: it is large, and each
//! further network would be a further copy of it, in the compiler as in the instruction cache.

use core::marker::PhantomData;

use crawler_hal::{LinkMonitor, LinkState, NetError, Network};
use embedded_io_async::{Error as _, ErrorKind, ErrorType, Read, Write};

#[cfg(feature = "live")]
use super::live::{LiveMonitor, SecuredLiveStream, SecuredNetwork};
use super::lockstep::{LockstepMonitor, LockstepNetwork, LockstepStream};
use super::none::{NoMonitor, NoNetwork, NoStream};

/// A robot's way to its broker.
pub(crate) enum SimNetwork {
    /// There is none.
    None(NoNetwork),
    /// In the process, in virtual time.
    Lockstep(LockstepNetwork),
    /// Over real sockets, with TLS or without.
    // Much larger than the others, of which there are many more.
    #[cfg(feature = "live")]
    Live(Box<SecuredNetwork>),
}

impl Network for SimNetwork {
    type Stream<'a> = SimStream<'a>;
    type Monitor = SimMonitor;

    fn monitor(&self) -> SimMonitor {
        match self {
            Self::None(network) => SimMonitor::None(network.monitor()),
            Self::Lockstep(network) => SimMonitor::Lockstep(network.monitor()),
            #[cfg(feature = "live")]
            Self::Live(network) => SimMonitor::Live(network.monitor()),
        }
    }

    async fn join(&mut self) -> Result<(), NetError> {
        match self {
            Self::None(network) => network.join().await,
            Self::Lockstep(network) => network.join().await,
            #[cfg(feature = "live")]
            Self::Live(network) => Box::pin(network.join()).await,
        }
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<SimStream<'_>, NetError> {
        match self {
            Self::None(network) => {
                let stream = network.connect(host, port).await?;
                Ok(SimStream::None(stream, PhantomData))
            }
            Self::Lockstep(network) => {
                let stream = network.connect(host, port).await?;
                Ok(SimStream::Lockstep(stream))
            }
            #[cfg(feature = "live")]
            Self::Live(network) => {
                let stream = Box::pin(network.connect(host, port)).await?;
                Ok(SimStream::Live(Box::new(stream)))
            }
        }
    }
}

/// Tells how the link of a [`SimNetwork`] is.
#[derive(Debug, Clone)]
pub(crate) enum SimMonitor {
    /// There is none.
    None(NoMonitor),
    /// In the process, in virtual time.
    Lockstep(LockstepMonitor),
    /// Over real sockets.
    #[cfg(feature = "live")]
    Live(LiveMonitor),
}

impl LinkMonitor for SimMonitor {
    fn state(&self) -> LinkState {
        match self {
            Self::None(monitor) => monitor.state(),
            Self::Lockstep(monitor) => monitor.state(),
            #[cfg(feature = "live")]
            Self::Live(monitor) => monitor.state(),
        }
    }
}

/// A connection over a [`SimNetwork`]. Dropping it ends the connection.
///
/// What waits on a real socket is kept on the heap while it waits: a future is as large as the
/// largest of what it may wait for, and robots in virtual time are not to pay for sockets.
#[derive(Debug)]
pub(crate) enum SimStream<'a> {
    /// There is none. Without `live` nothing else knows how long a network is lent.
    None(NoStream, PhantomData<&'a mut SimNetwork>),
    /// In the process, in virtual time.
    Lockstep(LockstepStream),
    /// Over a real socket.
    #[cfg(feature = "live")]
    Live(Box<SecuredLiveStream<'a>>),
}

impl ErrorType for SimStream<'_> {
    /// All that a program gets to know of what is wrong.
    type Error = ErrorKind;
}

impl Read for SimStream<'_> {
    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, ErrorKind> {
        match self {
            Self::None(stream, _) => stream.read(buf).await.map_err(|error| error.kind()),
            Self::Lockstep(stream) => stream.read(buf).await.map_err(|error| error.kind()),
            #[cfg(feature = "live")]
            Self::Live(stream) => {
                let read = Box::pin(stream.read(buf));
                read.await.map_err(|error| error.kind())
            }
        }
    }
}

impl Write for SimStream<'_> {
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, ErrorKind> {
        match self {
            Self::None(stream, _) => stream.write(buf).await.map_err(|error| error.kind()),
            Self::Lockstep(stream) => stream.write(buf).await.map_err(|error| error.kind()),
            #[cfg(feature = "live")]
            Self::Live(stream) => {
                let write = Box::pin(stream.write(buf));
                write.await.map_err(|error| error.kind())
            }
        }
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        match self {
            Self::None(stream, _) => stream.flush().await.map_err(|error| error.kind()),
            Self::Lockstep(stream) => stream.flush().await.map_err(|error| error.kind()),
            #[cfg(feature = "live")]
            Self::Live(stream) => {
                let flush = Box::pin(stream.flush());
                flush.await.map_err(|error| error.kind())
            }
        }
    }
}
