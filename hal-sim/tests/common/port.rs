//! A port at which nobody listens.

use std::net::SocketAddr;

use tokio::net::TcpSocket;

/// An address that refuses every connection for as long as the socket is kept: it is bound, so that
/// nobody else can listen there either.
pub(crate) fn refusing() -> (TcpSocket, SocketAddr) {
    let kept = TcpSocket::new_v4().expect("a socket");
    kept.bind(([127, 0, 0, 1], 0).into()).expect("any port");
    let address = kept.local_addr().expect("it is bound");
    (kept, address)
}
