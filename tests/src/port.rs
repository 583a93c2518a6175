//! Ports of loopback that nobody else is given.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};

use tokio::net::TcpSocket;

/// A port of loopback that is ours while this value lives: bound, and not listened at.
///
/// Whoever connects is refused. A server that sets `SO_REUSEADDR`, as all of them do, can be told
/// to listen there, and when it has ended another can. Linux gives the port to nobody who asks for
/// any free one, neither to a listener nor to a connection (`inet_csk_find_open_port` and
/// `__inet_hash_connect` pass over ports that are bound).
#[derive(Debug)]
pub struct ReservedPort {
    number: u16,
    _bound: TcpSocket,
}

impl ReservedPort {
    /// Takes a port.
    ///
    /// # Panics
    /// When there is none left.
    pub fn new() -> Self {
        let (socket, address) = bind(0).expect("a port of loopback");
        Self {
            number: address.port(),
            _bound: socket,
        }
    }

    /// Its number.
    pub fn number(&self) -> u16 {
        self.number
    }
}

impl Default for ReservedPort {
    fn default() -> Self {
        Self::new()
    }
}

fn bind(port: u16) -> io::Result<(TcpSocket, SocketAddr)> {
    let socket = TcpSocket::new_v4()?;
    socket.set_reuseaddr(true)?;
    socket.bind((Ipv4Addr::LOCALHOST, port).into())?;
    let address = socket.local_addr()?;
    Ok((socket, address))
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, TcpStream};

    use super::*;

    #[test]
    fn nobody_answers_there_until_a_server_does_and_after_it_ended() {
        let port = ReservedPort::new();
        let connect = || TcpStream::connect((Ipv4Addr::LOCALHOST, port.number()));
        let refused = |answer: io::Result<TcpStream>| {
            let kind = answer.expect_err("nobody is there").kind();
            assert_eq!(kind, io::ErrorKind::ConnectionRefused);
        };
        refused(connect());
        for _ in 0..2 {
            // It sets SO_REUSEADDR.
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port.number()));
            let listener = listener.expect("it is ours");
            let here = connect().expect("somebody is there");
            let (there, _) = listener.accept().expect("a connection");
            // The end that closes first is the one that lingers at the port.
            drop((there, here, listener));
            refused(connect());
        }
    }

    #[test]
    fn nobody_else_is_given_it() {
        let port = ReservedPort::new();
        let stranger = TcpSocket::new_v4().expect("a socket");
        stranger.set_reuseaddr(false).expect("an option");
        let taken = stranger.bind((Ipv4Addr::LOCALHOST, port.number()).into());
        let kind = taken.expect_err("it is taken").kind();
        assert_eq!(kind, io::ErrorKind::AddrInUse);
    }
}
