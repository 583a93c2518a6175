//! A bad network for real byte streams: a TCP proxy that delays what passes through it as the
//! radio model says.
//!
//! It stands between robots, simulated or real, and any broker. A robot is known by the client
//! name in its first packet, so that places, cuts and partitions reach it whatever connection it
//! opens; who says no name is known by the address. Bytes are never changed, lost or reordered:
//! loss is the delay of sending again, a cut link holds everything until it heals. What waits is
//! bounded, and behind a full queue the sender waits.

mod air;
mod connection;
mod hello;
mod pump;

use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::{TcpListener, TcpSocket};
use tokio::sync::Semaphore;

pub use air::Signal;

use super::lockstep::Cut;
use super::radio::{Setup, WINDOW_US};
use air::Shared;

/// Connections waiting to be accepted.
const BACKLOG: u32 = 1_024;
/// What the operating system keeps of a stream on its side of a connection, bytes.
const SYSTEM_BUFFER: u32 = 64 * 1024;
/// What ending takes beyond the time given.
const STOP_GRACE: Duration = Duration::from_secs(1);

/// What a proxy is made of.
#[derive(Debug, Clone)]
pub struct ProxyConfig {
    /// Where it listens; port 0 takes any.
    pub listen: SocketAddr,
    /// Addresses of the broker, tried in this order.
    pub broker: Vec<SocketAddr>,
    /// The radio.
    pub setup: Setup,
    /// Connections at a time; more are closed at once.
    pub most_connections: usize,
}

/// How a proxy is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct ProxyMetrics {
    /// Connections open now.
    pub connections: usize,
    /// Connections accepted so far.
    pub accepted: u64,
    /// Connections closed because there were too many.
    pub refused: u64,
    /// Robots known by name or address.
    pub stations: usize,
    /// Bytes passed on to the broker.
    pub up_bytes: u64,
    /// Bytes passed on to robots.
    pub down_bytes: u64,
}

/// Why a proxy cannot start, or did not end as it should.
#[derive(Debug)]
#[non_exhaustive]
pub enum ProxyError {
    /// It cannot listen there.
    Listen(SocketAddr, io::Error),
    /// No thread or no runtime.
    Runtime(io::Error),
    /// It did not end in time.
    TimedOut,
}

impl fmt::Display for ProxyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Listen(address, error) => write!(f, "the radio proxy at {address}: {error}"),
            Self::Runtime(error) => write!(f, "starting the radio proxy: {error}"),
            Self::TimedOut => f.write_str("the radio proxy did not end in time"),
        }
    }
}

impl std::error::Error for ProxyError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Listen(_, error) | Self::Runtime(error) => Some(error),
            Self::TimedOut => None,
        }
    }
}

/// A proxy at work on a thread of its own. Dropping it asks it to end and does not wait.
#[derive(Debug)]
pub struct Proxy {
    shared: Arc<Shared>,
    address: SocketAddr,
    ended: Mutex<Receiver<()>>,
}

impl Proxy {
    /// Starts a proxy; when this returns, it listens.
    ///
    /// # Errors
    /// See [`ProxyError`]. A broker that is not there is no error: robots are turned away until
    /// it is.
    pub fn start(config: &ProxyConfig) -> Result<Self, ProxyError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .map_err(ProxyError::Runtime)?;
        let failed = |error| ProxyError::Listen(config.listen, error);
        let listener = {
            let _entered = runtime.enter();
            listen(config.listen).map_err(failed)?
        };
        let address = listener.local_addr().map_err(failed)?;
        let shared = Arc::new(Shared::new(config));
        let (end_to, ended) = sync_channel(1);
        std::thread::Builder::new()
            .name("radio".into())
            .spawn({
                let shared = Arc::clone(&shared);
                move || {
                    runtime.block_on(accept(&shared, listener));
                    // Whatever is left is dropped with the runtime.
                    drop(runtime);
                    let _ = end_to.send(());
                }
            })
            .map_err(ProxyError::Runtime)?;
        Ok(Self {
            shared,
            address,
            ended: Mutex::new(ended),
        })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// An address at which a program of the same machine reaches it.
    pub(crate) fn reachable(&self) -> SocketAddr {
        let mut address = self.address;
        match address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
            IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
            _ => {}
        }
        address
    }

    /// What the robot of that name can know of its link, now and later.
    #[must_use]
    pub fn signal(&self, name: &str) -> tokio::sync::watch::Receiver<Signal> {
        self.shared.signal(name)
    }

    /// Tells where robots are, metres from the middle of the arena. Those never placed hear an
    /// access point without a place.
    pub fn place<'a>(&self, robots: impl IntoIterator<Item = (&'a str, (f32, f32))>) {
        self.shared.place(robots);
    }

    /// Cuts or heals the link of a robot, whether or not it is there yet.
    pub fn cut(&self, name: &str, cut: Cut) {
        self.shared.cut(name, cut);
    }

    /// Cuts or heals all links, also of robots that come later.
    pub fn cut_all(&self, cut: Cut) {
        self.shared.cut_all(cut);
    }

    /// How it is doing.
    #[must_use]
    pub fn metrics(&self) -> ProxyMetrics {
        self.shared.metrics()
    }

    /// Accepts nothing more, gives what is under way up to `patience` to arrive, and ends. Blocks.
    ///
    /// # Errors
    /// [`ProxyError::TimedOut`] when it does not end within a second more.
    pub fn stop(&self, patience: Duration) -> Result<(), ProxyError> {
        self.shared.ask_stop(patience);
        let ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        match ended.recv_timeout(patience.saturating_add(STOP_GRACE)) {
            Ok(()) | Err(RecvTimeoutError::Disconnected) => Ok(()),
            Err(RecvTimeoutError::Timeout) => Err(ProxyError::TimedOut),
        }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.shared.ask_stop(Duration::ZERO);
    }
}

fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() {
        TcpSocket::new_v4()?
    } else {
        TcpSocket::new_v6()?
    };
    socket.set_reuseaddr(true)?;
    // Accepted sockets take them over. Without a limit the system would take in megabytes
    // before a sender feels that its link is slow.
    socket.set_recv_buffer_size(SYSTEM_BUFFER)?;
    socket.set_send_buffer_size(SYSTEM_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Runs until told to stop, and then until all is delivered or the patience is over.
async fn accept(shared: &Arc<Shared>, listener: TcpListener) {
    let places = Arc::new(Semaphore::new(shared.most_connections()));
    tokio::spawn(turn(Arc::clone(shared)));
    let accepting = async {
        loop {
            match listener.accept().await {
                Ok((client, peer)) => match Arc::clone(&places).try_acquire_owned() {
                    Ok(place) => {
                        let work = connection::serve(Arc::clone(shared), client, peer, place);
                        tokio::spawn(work);
                    }
                    Err(_) => shared.refuse(),
                },
                // Out of descriptors, or the peer has gone already.
                Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
            }
        }
    };
    embassy_futures::select::select(accepting, shared.asked_to_stop()).await;
    // Nobody is to believe in a connection that is not served any more.
    drop(listener);
    let all = shared.most_connections() as u32;
    let _ = tokio::time::timeout(shared.patience(), places.acquire_many(all)).await;
}

/// Moves the radio on, window by window, in real time.
async fn turn(shared: Arc<Shared>) {
    let mut windows = 0_u64;
    loop {
        windows += 1;
        tokio::time::sleep_until(shared.at(windows * WINDOW_US)).await;
        shared.turn(windows * WINDOW_US);
    }
}
