//! The way to the broker, over embassy-net.
//!
//! One TCP socket lives as long as the network: a stream borrows it, and dropping the stream
//! resets the connection. A socket that were made anew for each connection would vanish with it,
//! and the broker would keep a dead connection until its keep-alive ran out.

use core::net::IpAddr;

use crawler_hal::{LinkMonitor, LinkState, NetError, Network};
use embassy_net::tcp::{ConnectError, Error, TcpSocket};
use embassy_net::{IpAddress, Stack, dns::DnsQueryType};
use embassy_time::{Duration, with_timeout};
use embedded_io_async::{ErrorType, Read, Write};

/// How long the medium may take to come up.
pub const MEDIUM_WITHIN: Duration = Duration::from_secs(4);
/// How long DHCP may take once the medium is up. Its first retry comes after ten seconds, so a
/// single lost datagram does not fail the attempt.
pub const ADDRESS_WITHIN: Duration = Duration::from_secs(11);
/// How long the reset of the connection before may wait for its turn.
const RESET_WITHIN: Duration = Duration::from_millis(250);
/// Silence of the other end, with data under way, after which a connection is given up. Above the
/// patience of the link, which decides first and says why.
const GIVEN_UP_AFTER: Duration = Duration::from_secs(20);

/// What lies below the network stack: a cable, or a radio that has to be joined first.
pub trait Medium {
    /// Handle to its signal.
    type Signal: Signal;

    /// A handle that keeps telling the strength of the signal.
    fn signal(&self) -> Self::Signal;

    /// Brings the medium up; returns at once when it is.
    ///
    /// # Errors
    /// [`NetError::NotJoined`] or [`NetError::BadCredentials`].
    ///
    /// # Cancellation Safety
    /// A dropped call may leave the medium half up; the next call starts afresh.
    async fn bring_up(&mut self) -> Result<(), NetError>;
}

/// Strength of a signal.
pub trait Signal: Clone {
    /// In dBm; `None` where the medium has none, or is down.
    fn rssi_dbm(&self) -> Option<i8>;
}

/// A cable: it is up, or someone has to plug it in.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cable;

impl Medium for Cable {
    type Signal = Self;

    fn signal(&self) -> Self {
        *self
    }

    async fn bring_up(&mut self) -> Result<(), NetError> {
        Ok(())
    }
}

impl Signal for Cable {
    fn rssi_dbm(&self) -> Option<i8> {
        None
    }
}

/// A robot's network over a stack that gets its address from DHCP.
pub struct StackNetwork<'d, M> {
    stack: Stack<'d>,
    medium: M,
    socket: TcpSocket<'d>,
}

impl<M: core::fmt::Debug> core::fmt::Debug for StackNetwork<'_, M> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("StackNetwork")
            .field("medium", &self.medium)
            .finish_non_exhaustive()
    }
}

impl<'d, M: Medium> StackNetwork<'d, M> {
    /// A network over `stack`, whose runner the board polls. The buffers are those of its one
    /// connection.
    pub fn new(stack: Stack<'d>, medium: M, receive: &'d mut [u8], transmit: &'d mut [u8]) -> Self {
        Self {
            stack,
            medium,
            socket: TcpSocket::new(stack, receive, transmit),
        }
    }

    async fn resolve(&self, host: &str) -> Result<IpAddress, NetError> {
        if let Ok(address) = host.parse::<IpAddr>() {
            return match address {
                IpAddr::V4(address) => Ok(IpAddress::Ipv4(address)),
                // The stack speaks IPv4 alone.
                IpAddr::V6(_) => Err(NetError::UnknownHost),
            };
        }
        // Any failure means that nobody could be asked, or that nobody knows.
        let found = self.stack.dns_query(host, DnsQueryType::A).await;
        found
            .ok()
            .and_then(|addresses| addresses.first().copied())
            .ok_or(NetError::UnknownHost)
    }
}

impl<'d, M: Medium> Network for StackNetwork<'d, M> {
    type Stream<'a>
        = StackStream<'a, 'd>
    where
        Self: 'a;
    type Monitor = StackMonitor<'d, M::Signal>;

    fn monitor(&self) -> Self::Monitor {
        StackMonitor {
            stack: self.stack,
            signal: self.medium.signal(),
        }
    }

    async fn join(&mut self) -> Result<(), NetError> {
        self.medium.bring_up().await?;
        with_timeout(MEDIUM_WITHIN, self.stack.wait_link_up())
            .await
            .map_err(|_| NetError::NotJoined)?;
        with_timeout(ADDRESS_WITHIN, self.stack.wait_config_up())
            .await
            .map_err(|_| NetError::NoAddress)
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<StackStream<'_, 'd>, NetError> {
        let address = self.resolve(host).await?;
        // Until the connection before is reset; without a link that takes for ever, and the
        // broker finds out by itself.
        let _ = with_timeout(RESET_WITHIN, self.socket.flush()).await;
        self.socket.set_timeout(Some(GIVEN_UP_AFTER));
        // The link writes whole packets.
        self.socket.set_nagle_enabled(false);
        // From here on a dropped call resets what it has opened.
        let stream = StackStream {
            socket: &mut self.socket,
        };
        stream
            .socket
            .connect((address, port))
            .await
            .map_err(|error| match error {
                ConnectError::ConnectionReset => NetError::Refused,
                ConnectError::TimedOut => NetError::TimedOut,
                ConnectError::NoRoute => NetError::NotJoined,
                ConnectError::InvalidState => NetError::NoResources,
            })?;
        Ok(stream)
    }
}

/// The one open connection. Dropping it resets it.
pub struct StackStream<'a, 'd> {
    socket: &'a mut TcpSocket<'d>,
}

impl Drop for StackStream<'_, '_> {
    fn drop(&mut self) {
        self.socket.abort();
    }
}

impl core::fmt::Debug for StackStream<'_, '_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("StackStream")
            .field("state", &self.socket.state())
            .finish_non_exhaustive()
    }
}

impl ErrorType for StackStream<'_, '_> {
    type Error = Error;
}

impl Read for StackStream<'_, '_> {
    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Error> {
        self.socket.read(buf).await
    }
}

impl Write for StackStream<'_, '_> {
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, Error> {
        self.socket.write(buf).await
    }

    /// Hands everything to the stack, which sends it on its own: waiting for the other end's
    /// acknowledgement would stop the link for a round trip with every packet.
    async fn flush(&mut self) -> Result<(), Error> {
        Ok(())
    }
}

/// Tells how the link is.
#[derive(Clone)]
pub struct StackMonitor<'d, S> {
    stack: Stack<'d>,
    signal: S,
}

impl<S> core::fmt::Debug for StackMonitor<'_, S> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("StackMonitor").finish_non_exhaustive()
    }
}

impl<S: Signal> LinkMonitor for StackMonitor<'_, S> {
    fn state(&self) -> LinkState {
        let config = self.stack.config_v4().filter(|_| self.stack.is_link_up());
        config.map_or(LinkState::Down, |config| LinkState::Up {
            address: IpAddr::V4(config.address.address()),
            rssi_dbm: self.signal.rssi_dbm(),
        })
    }
}
