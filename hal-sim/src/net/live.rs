//! Real sockets, inside a tokio runtime.

mod boundary;
mod wire;

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use crawler_hal::{LinkMonitor, LinkState, NetError, Network};
use crawler_tls::{Authority, Buffers, Secured, SecuredStream, Security};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use getrandom::SysRng;
use rand_core::UnwrapErr;
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, watch};

use super::fix::publisher::Outlet;
use super::lockstep::{Cut, NO_ADDRESS_AFTER, PASSWORD_REFUSED_AFTER};
use super::proxy::{Proxy, Signal};
use boundary::Boundary;
use wire::{LinkSwitch, Wire};

/// Connections being opened at once. A thousand at a time overrun the backlog of a broker.
const OPENING: usize = 64;

/// A clean end that still publishes the last will, which says that the robot is offline, and
/// ends the session: MQTT 5, section 3.14; reason 0x04, session expiry interval 0.
const GOODBYE: [u8; 9] = [0xE0, 7, 0x04, 5, 0x11, 0, 0, 0, 0];

/// Tells the seconds since 1970, once they are known.
pub(crate) type UnixClock = Box<dyn Fn() -> Option<u64>>;

/// A way over TLS where the world has an authority, and in the clear where it has none.
pub(crate) type SecuredNetwork = Secured<LiveNetwork, UnwrapErr<SysRng>, Box<Buffers>, UnixClock>;

/// A connection over it.
pub(crate) type SecuredLiveStream<'a> = SecuredStream<'a, LiveStream>;

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
    /// The radio between robots and broker.
    radio: Option<Arc<Proxy>>,
    /// Who has signed the broker's certificate, when robots are to speak TLS to it.
    authority: Option<Authority>,
    /// Links of robots that reach the broker without one.
    wires: RefCell<BTreeMap<String, Rc<Wire>>>,
}

impl Gateway {
    /// The way to one of `broker`, by way of `radio` where there is one, and over TLS with an
    /// authority.
    pub(crate) fn new(
        broker: Vec<SocketAddr>,
        radio: Option<Arc<Proxy>>,
        authority: Option<Authority>,
    ) -> Self {
        Self {
            shared: Rc::new(Shared {
                broker,
                opening: Semaphore::new(OPENING),
                connected: Cell::new(0),
                leaving: Cell::new(false),
                outlet: Rc::default(),
                address: RefCell::new(None),
                radio,
                authority,
                wires: RefCell::default(),
            }),
        }
    }

    /// The way of the robot of that name.
    pub(crate) fn network(&self, robot: &str) -> LiveNetwork {
        let (signal, link_switch) = if let Some(radio) = &self.shared.radio {
            // A radio holds a connection up by itself.
            (radio.signal(robot), None)
        } else {
            let wire = self.wire(robot);
            (wire.subscribe(), Some(LinkSwitch::new(&wire)))
        };
        LiveNetwork {
            shared: Rc::clone(&self.shared),
            robot: Some(signal),
            link_switch,
        }
    }

    /// Puts TLS over `network` when there is an authority.
    pub(crate) fn secure(&self, network: LiveNetwork, clock: UnixClock) -> SecuredNetwork {
        let security = self.shared.authority.map(|authority| Security {
            authority,
            // Keys are no part of what a seed names: nobody may be able to guess them.
            rng: UnwrapErr(SysRng),
            buffers: Box::new(Buffers::new()),
            clock,
        });
        Secured::new(network, security)
    }

    /// The same for what is no robot: it has a wire, and does not count as connected.
    pub(crate) fn service(&self) -> LiveNetwork {
        LiveNetwork {
            shared: Rc::clone(&self.shared),
            robot: None,
            link_switch: None,
        }
    }

    /// Cuts or heals the link of a robot.
    pub(crate) fn cut(&self, robot: &str, cut: Cut) {
        match &self.shared.radio {
            Some(radio) => radio.cut(robot, cut),
            None => self.wire(robot).cut(cut),
        }
    }

    fn wire(&self, robot: &str) -> Rc<Wire> {
        let mut wires = self.shared.wires.borrow_mut();
        if let Some(wire) = wires.get(robot) {
            return Rc::clone(wire);
        }
        let wire = Rc::new(Wire::new());
        wires.insert(robot.to_owned(), Rc::clone(&wire));
        wire
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
    /// What a robot can know of its link.
    robot: Option<watch::Receiver<Signal>>,
    /// The link itself, where nobody else holds bytes up while it is cut.
    link_switch: Option<LinkSwitch>,
}

impl Network for LiveNetwork {
    type Stream<'a> = LiveStream;
    type Monitor = LiveMonitor;

    fn monitor(&self) -> LiveMonitor {
        LiveMonitor {
            shared: Rc::clone(&self.shared),
            robot: self.robot.clone(),
        }
    }

    /// Waits for an access point as long as there is none, as in lockstep.
    async fn join(&mut self) -> Result<(), NetError> {
        let Some(link) = &mut self.robot else {
            return Ok(());
        };
        let signal = link.wait_for(|signal| signal.cut != Cut::Radio).await;
        let cut = signal.map_err(|_| NetError::NotJoined)?.cut;
        let (after, error) = match cut {
            Cut::None | Cut::Silent | Cut::Radio => return Ok(()),
            Cut::Password => (PASSWORD_REFUSED_AFTER, NetError::BadCredentials),
            Cut::NoAddress => (NO_ADDRESS_AFTER, NetError::NoAddress),
        };
        tokio::time::sleep(Duration::from_millis(after.as_millis())).await;
        Err(error)
    }

    async fn connect(&mut self, _host: &str, _port: u16) -> Result<LiveStream, NetError> {
        // Before the place is taken: those that cannot get through must not keep out the others.
        if let Some(link_switch) = &mut self.link_switch {
            link_switch.healed().await;
        }
        let _permit = self
            .shared
            .opening
            .acquire()
            .await
            .map_err(|_| NetError::NotJoined)?;
        let radio = self.robot.is_some().then_some(self.shared.radio.as_ref());
        let through: Vec<SocketAddr> = match radio.flatten() {
            Some(radio) => vec![radio.reachable()],
            None => self.shared.broker.clone(),
        };
        let mut last = NetError::UnknownHost;
        for address in through {
            match TcpStream::connect(address).await {
                Ok(tcp) => {
                    // Only costs latency when it fails.
                    let _ = tcp.set_nodelay(true);
                    if let Ok(own) = tcp.local_addr() {
                        *self.shared.address.borrow_mut() = Some(own.ip());
                    }
                    return Ok(LiveStream {
                        tcp: Rc::new(tcp),
                        shared: Rc::clone(&self.shared),
                        heard: false,
                        counted: self.robot.is_some(),
                        link_switch: self.link_switch.clone(),
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

/// Tells what a robot can know of its link: that of the radio where there is one.
#[derive(Debug, Clone)]
pub(crate) struct LiveMonitor {
    shared: Rc<Shared>,
    robot: Option<watch::Receiver<Signal>>,
}

impl LinkMonitor for LiveMonitor {
    fn state(&self) -> LinkState {
        let signal = self.robot.as_ref().map(|link| *link.borrow());
        if signal.is_some_and(|signal| signal.cut.is_known()) {
            return LinkState::Down;
        }
        let address = *self.shared.address.borrow();
        LinkState::Up {
            address: address.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST)),
            rssi_dbm: signal
                .filter(|_| self.shared.radio.is_some())
                .map(|signal| signal.rssi_dbm),
        }
    }
}

/// One connection. Dropping it closes it.
#[derive(Debug)]
pub(crate) struct LiveStream {
    tcp: Rc<TcpStream>,
    shared: Rc<Shared>,
    /// The broker has said something.
    heard: bool,
    /// It is that of a robot.
    counted: bool,
    /// The link, where nobody else holds bytes up while it is cut.
    link_switch: Option<LinkSwitch>,
    boundary: Boundary,
}

impl LiveStream {
    /// Waits while the link is cut.
    async fn healed(&mut self) {
        if let Some(link_switch) = &mut self.link_switch {
            link_switch.healed().await;
        }
    }

    fn is_cut(&self) -> bool {
        self.link_switch.as_ref().is_some_and(LinkSwitch::is_cut)
    }
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
            self.healed().await;
            self.tcp.readable().await.map_err(SocketError)?;
            if self.is_cut() {
                continue;
            }
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
            self.healed().await;
            self.tcp.writable().await.map_err(SocketError)?;
            if self.is_cut() {
                continue;
            }
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
        if let Some(link_switch) = self
            .link_switch
            .as_ref()
            .filter(|link_switch| link_switch.is_cut())
        {
            link_switch.keep(Rc::clone(&self.tcp));
            return;
        }
        // Beneath TLS nobody would understand it: the broker publishes the last will as well.
        let says = self.heard && self.boundary.is_between() && self.shared.authority.is_none();
        if self.shared.leaving.get() && says {
            // A socket that takes no nine bytes now is one the broker finds closed.
            let _ = self.tcp.try_write(&GOODBYE);
        }
    }
}
