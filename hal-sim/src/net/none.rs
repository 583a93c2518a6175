//! No network at all.

use std::convert::Infallible;
use std::future::pending;

use crawler_hal::{LinkMonitor, LinkState, NetError, Network};
use embedded_io_async::{ErrorType, Read, Write};

/// A radio that never finds an access point.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoNetwork;

/// Always down.
#[derive(Debug, Clone, Copy)]
pub struct NoMonitor;

/// The stream that [`NoNetwork`] never opens.
#[derive(Debug)]
pub struct NoStream(Infallible);

impl LinkMonitor for NoMonitor {
    fn state(&self) -> LinkState {
        LinkState::Down
    }
}

impl Network for NoNetwork {
    type Stream<'a> = NoStream;
    type Monitor = NoMonitor;

    fn monitor(&self) -> NoMonitor {
        NoMonitor
    }

    /// Never returns, as a radio out of reach of everything.
    async fn join(&mut self) -> Result<(), NetError> {
        pending().await
    }

    async fn connect(&mut self, _host: &str, _port: u16) -> Result<NoStream, NetError> {
        Err(NetError::NotJoined)
    }
}

impl ErrorType for NoStream {
    type Error = Infallible;
}

impl Read for NoStream {
    async fn read(&mut self, _buf: &mut [u8]) -> Result<usize, Infallible> {
        match self.0 {}
    }
}

impl Write for NoStream {
    async fn write(&mut self, _buf: &[u8]) -> Result<usize, Infallible> {
        match self.0 {}
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        match self.0 {}
    }
}
