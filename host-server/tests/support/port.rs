//! Ports of loopback that nobody else is given.

use std::net::SocketAddr;

use tokio::net::TcpSocket;

/// A port that is taken and listened at by nobody.
///
/// Whoever connects to it is refused, and the system gives it to nobody who asks for any port. A
/// server that is told to listen at it still can, since servers bind with `SO_REUSEADDR` as this
/// does: so it serves for a server that comes, goes and comes back to the same port as well.
pub struct ReservedPort {
    _bound: TcpSocket,
    address: SocketAddr,
}

impl ReservedPort {
    pub fn new() -> Self {
        let socket = TcpSocket::new_v4().expect("a socket");
        socket.set_reuseaddr(true).expect("an option");
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        socket.bind(any).expect("a port");
        let address = socket.local_addr().expect("its address");
        Self {
            _bound: socket,
            address,
        }
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    pub fn port(&self) -> u16 {
        self.address.port()
    }
}
