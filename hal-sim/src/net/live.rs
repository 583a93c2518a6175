//! Real sockets, inside a tokio runtime.

use std::cell::{Cell, RefCell};
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::rc::Rc;

use crawler_hal::{LinkMonitor, LinkState, NetError, Network};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use tokio::net::TcpStream;
use tokio::sync::Semaphore;

use super::tracker::Outlet;

/// Connections being opened at once. A thousand at a time overrun the backlog of a broker.
const OPENING: usize = 64;

/// A clean end that still publishes the last will, which says that the robot is offline, and
/// ends the session: MQTT 5, section 3.14; reason 0x04, session expiry interval 0.
const GOODBYE: [u8; 9] = [0xE0, 7, 0x04, 5, 0x11, 0, 0, 0, 0];

/// The way of all robots of one live world to one broker. A handle.
#[derive(Clone, Debug)]
pub(crate) struct Gateway {
    shared: Rc<Shared>,
}

#[derive(Debug)]
struct Shared {
    /// Addresses of the broker, resolved before the world starts.
    broker: Vec<SocketAddr>,
    opening: Semaphore,
    connected: Cell<u32>,
    leaving: Cell<bool>,
    outlet: Rc<Outlet>,
    /// Our own address towards the broker, once known.
    address: RefCell<Option<IpAddr>>,
}

impl Gateway {
    pub(crate) fn new(broker: Vec<SocketAddr>) -> Self {
        Self {
            shared: Rc::new(Shared {
                broker,
                opening: Semaphore::new(OPENING),
                connected: Cell::new(0),
                leaving: Cell::new(false),
                outlet: Rc::default(),
                address: RefCell::new(None),
            }),
        }
    }

    pub(crate) fn network(&self) -> LiveNetwork {
        LiveNetwork {
            shared: Rc::clone(&self.shared),
            counted: true,
        }
    }

    /// The same for what is no robot: it does not count as connected.
    pub(crate) fn service(&self) -> LiveNetwork {
        LiveNetwork {
            counted: false,
            ..self.network()
        }
    }

    /// Where the camera of the world leaves what it sees.
    pub(crate) fn outlet(&self) -> &Rc<Outlet> {
        &self.shared.outlet
    }

    /// Connections on which the broker has said something.
    pub(crate) fn connected(&self) -> u32 {
        self.shared.connected.get()
    }

    /// From now on streams that end say goodbye to the broker.
    pub(crate) fn leave(&self) {
        self.shared.leaving.set(true);
    }
}

/// A robot's way to a real broker, whatever host it asks for: the host was resolved once for all.
#[derive(Debug)]
pub(crate) struct LiveNetwork {
    shared: Rc<Shared>,
    counted: bool,
}

impl Network for LiveNetwork {
    type Stream<'a> = LiveStream;
    type Monitor = LiveMonitor;

    fn monitor(&self) -> LiveMonitor {
        LiveMonitor {
            shared: Rc::clone(&self.shared),
        }
    }

    async fn join(&mut self) -> Result<(), NetError> {
        Ok(())
    }

    async fn connect(&mut self, _host: &str, _port: u16) -> Result<LiveStream, NetError> {
        let _permit = self
            .shared
            .opening
            .acquire()
            .await
            .map_err(|_| NetError::NotJoined)?;
        let mut last = NetError::UnknownHost;
        for &address in &self.shared.broker {
            match TcpStream::connect(address).await {
                Ok(tcp) => {
                    // Only costs latency when it fails.
                    let _ = tcp.set_nodelay(true);
                    if let Ok(own) = tcp.local_addr() {
                        *self.shared.address.borrow_mut() = Some(own.ip());
                    }
                    return Ok(LiveStream {
                        tcp,
                        shared: Rc::clone(&self.shared),
                        heard: false,
                        counted: self.counted,
                        boundary: Boundary::default(),
                    });
                }
                Err(error) => last = net_error(&error),
            }
        }
        Err(last)
    }
}

fn net_error(error: &io::Error) -> NetError {
    match error.kind() {
        io::ErrorKind::ConnectionRefused => NetError::Refused,
        io::ErrorKind::TimedOut => NetError::TimedOut,
        io::ErrorKind::NetworkUnreachable | io::ErrorKind::NetworkDown => NetError::NotJoined,
        // Out of descriptors or ports, mostly.
        _ => NetError::NoResources,
    }
}

/// The host is joined for as long as the program runs.
#[derive(Debug, Clone)]
pub(crate) struct LiveMonitor {
    shared: Rc<Shared>,
}

impl LinkMonitor for LiveMonitor {
    fn state(&self) -> LinkState {
        let address = *self.shared.address.borrow();
        LinkState::Up {
            address: address.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST)),
            rssi_dbm: None,
        }
    }
}

/// One connection. Dropping it closes it.
#[derive(Debug)]
pub(crate) struct LiveStream {
    tcp: TcpStream,
    shared: Rc<Shared>,
    /// The broker has said something.
    heard: bool,
    /// It is that of a robot.
    counted: bool,
    boundary: Boundary,
}

/// What the operating system said of a socket.
#[derive(Debug)]
pub(crate) struct SocketError(io::Error);

impl std::fmt::Display for SocketError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for SocketError {}

impl embedded_io_async::Error for SocketError {
    fn kind(&self) -> ErrorKind {
        match self.0.kind() {
            io::ErrorKind::ConnectionReset => ErrorKind::ConnectionReset,
            io::ErrorKind::ConnectionAborted => ErrorKind::ConnectionAborted,
            io::ErrorKind::BrokenPipe => ErrorKind::BrokenPipe,
            io::ErrorKind::NotConnected => ErrorKind::NotConnected,
            io::ErrorKind::TimedOut => ErrorKind::TimedOut,
            _ => ErrorKind::Other,
        }
    }
}

impl ErrorType for LiveStream {
    type Error = SocketError;
}

impl Read for LiveStream {
    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, SocketError> {
        if buf.is_empty() {
            return Ok(0);
        }
        loop {
            self.tcp.readable().await.map_err(SocketError)?;
            match self.tcp.try_read(buf) {
                Ok(taken) => {
                    if taken > 0 && !self.heard {
                        self.heard = true;
                        if self.counted {
                            self.shared.connected.set(self.shared.connected.get() + 1);
                        }
                    }
                    return Ok(taken);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(SocketError(error)),
            }
        }
    }
}

impl Write for LiveStream {
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, SocketError> {
        if buf.is_empty() {
            return Ok(0);
        }
        loop {
            self.tcp.writable().await.map_err(SocketError)?;
            match self.tcp.try_write(buf) {
                Ok(written) => {
                    self.boundary.advance(&buf[..written]);
                    return Ok(written);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(SocketError(error)),
            }
        }
    }

    async fn flush(&mut self) -> Result<(), SocketError> {
        Ok(())
    }
}

impl Drop for LiveStream {
    fn drop(&mut self) {
        if self.heard && self.counted {
            self.shared.connected.set(self.shared.connected.get() - 1);
        }
        if self.shared.leaving.get() && self.heard && self.boundary.is_between() {
            // A socket that takes no nine bytes now is one the broker finds closed.
            let _ = self.tcp.try_write(&GOODBYE);
        }
    }
}

/// Where in the stream of MQTT packets a connection stands (section 2.1 of the standard).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Boundary {
    /// Between two packets.
    #[default]
    Between,
    /// In the length of a packet: what is known of it, and how many bits.
    Length(usize, u32),
    /// So many bytes before the end of a packet.
    Within(usize),
}

impl Boundary {
    fn is_between(self) -> bool {
        self == Self::Between
    }

    fn advance(&mut self, mut bytes: &[u8]) {
        while let Some((&byte, rest)) = bytes.split_first() {
            *self = match *self {
                Self::Between => Self::Length(0, 0),
                Self::Length(value, bits) => {
                    let value = value | usize::from(byte & 0x7F) << bits;
                    if byte & 0x80 != 0 && bits < 21 {
                        Self::Length(value, bits + 7)
                    } else if value == 0 {
                        Self::Between
                    } else {
                        Self::Within(value)
                    }
                }
                Self::Within(left) => {
                    let part = left.min(bytes.len());
                    bytes = &bytes[part..];
                    *self = if part == left {
                        Self::Between
                    } else {
                        Self::Within(left - part)
                    };
                    continue;
                }
            };
            bytes = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_boundaries_are_found_however_the_bytes_are_split() {
        let mut stream = vec![0xC0, 0];
        stream.extend([0x30, 3, 1, 2, 3]);
        let long = stream.len();
        stream.extend([0x30, 0xC8, 0x01]);
        stream.extend([9; 200]);
        let ends = [2, long, stream.len()];
        for split in 1..stream.len() {
            let mut boundary = Boundary::default();
            boundary.advance(&stream[..split]);
            assert_eq!(
                boundary.is_between(),
                ends.contains(&split),
                "after {split}"
            );
            boundary.advance(&stream[split..]);
            assert!(boundary.is_between());
        }
    }
}
