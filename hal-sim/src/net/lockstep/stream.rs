//! A robot's end of the network: its interface, and the stream it opens.

use std::future::poll_fn;
use std::net::{IpAddr, Ipv4Addr};
use std::task::Poll;

use crawler_hal::{Clock, Duration, Instant, LinkMonitor, LinkState, NetError, Network};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

use super::pipe::HELD;
use super::{Cut, Event, SEND_BUFFER, VirtualNetwork};
use crate::net::radio::Direction;

/// What four failed handshakes take.
pub const PASSWORD_REFUSED_AFTER: Duration = Duration::from_millis(1_500);
/// Four DHCP discoveries at 1, 2, 4 and 3 seconds, unanswered.
pub const NO_ADDRESS_AFTER: Duration = Duration::from_secs(10);

/// A robot's way to the broker of its simulation, whatever host it asks for.
#[derive(Debug)]
pub struct LockstepNetwork {
    network: VirtualNetwork,
    link: usize,
}

impl LockstepNetwork {
    pub(super) const fn new(network: VirtualNetwork, link: usize) -> Self {
        Self { network, link }
    }

    /// Number of the link, for `VirtualNetwork::cut` and `VirtualNetwork::rejoin`.
    #[must_use]
    pub const fn link(&self) -> usize {
        self.link
    }

    async fn healed(&self, unless: impl Fn(Cut) -> bool) {
        poll_fn(|cx| {
            let link = &mut self.network.state.borrow_mut().links[self.link];
            if unless(link.state()) {
                return Poll::Ready(());
            }
            link.waiting = Some(cx.waker().clone());
            Poll::Pending
        })
        .await;
    }
}

impl Network for LockstepNetwork {
    type Stream<'a> = LockstepStream;
    type Monitor = LockstepMonitor;

    fn monitor(&self) -> LockstepMonitor {
        LockstepMonitor {
            network: self.network.clone(),
            link: self.link,
        }
    }

    /// Waits for an access point as long as there is none; a refusal takes
    /// [`PASSWORD_REFUSED_AFTER`], silence instead of an address [`NO_ADDRESS_AFTER`].
    async fn join(&mut self) -> Result<(), NetError> {
        self.healed(|cut| cut != Cut::Radio).await;
        let cut = self.network.state.borrow().links[self.link].state();
        let (after, error) = match cut {
            Cut::None | Cut::Silent | Cut::Radio => return Ok(()),
            Cut::Password => (PASSWORD_REFUSED_AFTER, NetError::BadCredentials),
            Cut::NoAddress => (NO_ADDRESS_AFTER, NetError::NoAddress),
        };
        self.network.clock.sleep(after).await;
        Err(error)
    }

    /// Takes one and a half round trips, like a TCP handshake and its last acknowledgement. Waits
    /// while the link is cut.
    async fn connect(&mut self, _host: &str, _port: u16) -> Result<LockstepStream, NetError> {
        for _ in 0..2 {
            self.healed(|cut| cut == Cut::None).await;
            let now = self.network.now();
            let delay = self.network.state.borrow_mut().delay(self.link, now);
            self.network.clock.sleep(Duration::from_micros(delay)).await;
        }
        let index = {
            let now = self.network.now();
            if self.network.state.borrow().stopped {
                return Err(NetError::Refused);
            }
            self.network.state.borrow_mut().open(self.link, now)
        };
        Ok(LockstepStream {
            network: self.network.clone(),
            index,
        })
    }
}

/// Tells whether the radio of a robot has its access point.
#[derive(Debug, Clone)]
pub struct LockstepMonitor {
    network: VirtualNetwork,
    link: usize,
}

impl LinkMonitor for LockstepMonitor {
    fn state(&self) -> LinkState {
        let state = self.network.state.borrow();
        if state.links[self.link].state().is_known() {
            return LinkState::Down;
        }
        let host = self.link as u32 + 1;
        LinkState::Up {
            address: IpAddr::V4(Ipv4Addr::from_bits(0x0A00_0000 | (host & 0x00FF_FFFF))),
            rssi_dbm: Some(match &state.radio {
                Some(radio) => radio.rssi_dbm(self.link),
                None => state.model.rssi_dbm,
            }),
        }
    }
}

/// One connection of a robot. Dropping it ends the connection.
#[derive(Debug)]
pub struct LockstepStream {
    network: VirtualNetwork,
    index: usize,
}

/// The broker closed the connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConnectionReset;

impl std::fmt::Display for ConnectionReset {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the broker closed the connection")
    }
}

impl std::error::Error for ConnectionReset {}

impl embedded_io_async::Error for ConnectionReset {
    fn kind(&self) -> ErrorKind {
        ErrorKind::ConnectionReset
    }
}

impl ErrorType for LockstepStream {
    type Error = ConnectionReset;
}

/// What a look at the pipe told a reader.
enum Progress {
    Done(usize),
    Until(u64),
}

impl Read for LockstepStream {
    /// # Cancellation Safety
    /// A dropped call takes no byte.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, ConnectionReset> {
        if buf.is_empty() {
            return Ok(0);
        }
        loop {
            let progress = poll_fn(|cx| {
                let now = self.network.now();
                let mut state = self.network.state.borrow_mut();
                let Some(Some(connection)) = state.connections.get_mut(self.index) else {
                    return Poll::Ready(Progress::Done(0));
                };
                let taken = connection.down.read(now, buf);
                if taken > 0 {
                    return Poll::Ready(Progress::Done(taken));
                }
                match connection.down.next_arrival() {
                    Some(HELD) => {}
                    Some(at) => return Poll::Ready(Progress::Until(at)),
                    None if connection.down.ended => return Poll::Ready(Progress::Done(0)),
                    None => {}
                }
                connection.down.reader = Some(cx.waker().clone());
                Poll::Pending
            })
            .await;
            match progress {
                Progress::Done(taken) => return Ok(taken),
                Progress::Until(at) => {
                    self.network
                        .clock
                        .sleep_until(Instant::from_micros(at))
                        .await;
                }
            }
        }
    }
}

impl Write for LockstepStream {
    /// # Cancellation Safety
    /// A dropped call has written nothing.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, ConnectionReset> {
        if buf.is_empty() {
            return Ok(0);
        }
        poll_fn(|cx| {
            let now = self.network.now();
            let state = &mut *self.network.state.borrow_mut();
            let Some(Some(connection)) = state.connections.get_mut(self.index) else {
                return Poll::Ready(Err(ConnectionReset));
            };
            if connection.closed {
                return Poll::Ready(Err(ConnectionReset));
            }
            let room = SEND_BUFFER.saturating_sub(connection.up.len());
            if room == 0 {
                connection.up.writer = Some(cx.waker().clone());
                return Poll::Pending;
            }
            let link = connection.link;
            let len = room.min(buf.len());
            let arrival = state.arrival(link, Direction::Up, len, now);
            if let Some(Some(connection)) = state.connections.get_mut(self.index) {
                let arrival = connection.up.write(&buf[..len], arrival);
                if arrival != HELD {
                    state.schedule(arrival, Some(link), Event::Arrival(self.index as u32));
                }
            }
            Poll::Ready(Ok(len))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), ConnectionReset> {
        Ok(())
    }
}

impl Drop for LockstepStream {
    fn drop(&mut self) {
        let now = self.network.now();
        self.network.state.borrow_mut().abandon(self.index, now);
    }
}
