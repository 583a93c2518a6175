//! Joining a network and opening byte streams.

use core::net::IpAddr;

use embedded_io_async::{Read, Write};

/// Why a network operation failed. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum NetError {
    /// No access point answered, or it refused us: try again later, or fall back.
    NotJoined,
    /// The access point refused the password: it has to be set anew.
    BadCredentials,
    /// The network was joined, but nobody there hands out addresses.
    NoAddress,
    /// The host name does not resolve: the configuration may be wrong.
    UnknownHost,
    /// The host refused the connection: the service is not there yet.
    Refused,
    /// Nothing answered in time.
    TimedOut,
    /// The body has no room for another stream.
    NoResources,
    /// The other end has not proved who it is, or does not speak as agreed: nothing was said to it.
    /// A word says why, the same in every version.
    Insecure(&'static str),
}

/// What is known of the way to the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkState {
    /// Not joined.
    Down,
    /// Joined.
    Up {
        /// Our address.
        address: IpAddr,
        /// Signal strength, where the medium has one.
        rssi_dbm: Option<i8>,
    },
}

/// A cheap handle that tells how the link is, while a stream is open.
pub trait LinkMonitor: Clone {
    /// The state right now.
    fn state(&self) -> LinkState;
}

/// The way out of a body.
pub trait Network {
    /// An open connection. Closed by dropping it.
    type Stream<'a>: Read + Write
    where
        Self: 'a;
    /// Handle to the state of the link.
    type Monitor: LinkMonitor;

    /// A handle that keeps telling the state of the link.
    fn monitor(&self) -> Self::Monitor;

    /// Joins the network and gets an address; returns at once when already joined.
    ///
    /// # Errors
    /// [`NetError::NotJoined`], [`NetError::BadCredentials`], [`NetError::NoAddress`] or
    /// [`NetError::TimedOut`]; the caller retries.
    ///
    /// # Cancellation Safety
    /// A dropped call may leave the network half joined; the next call starts afresh.
    async fn join(&mut self) -> Result<(), NetError>;

    /// Opens a byte stream to `host` (a name or an address) at `port`.
    ///
    /// # Errors
    /// See [`NetError`]. May take as long as the medium's own time-out: give it a deadline.
    ///
    /// # Cancellation Safety
    /// A dropped call opens nothing.
    async fn connect(&mut self, host: &str, port: u16) -> Result<Self::Stream<'_>, NetError>;
}
