//! Whom a request came from, as far as the connection tells.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use axum::http::{HeaderMap, Request, header};

/// The other end of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Peer {
    /// Its address.
    pub(crate) address: SocketAddr,
    /// Whether the connection is encrypted up to this process.
    pub(crate) tls: bool,
}

impl Peer {
    /// Leaves a note of it at a request of the connection.
    pub(super) fn mark<B>(self, request: &mut Request<B>) {
        request.extensions_mut().insert(self);
    }

    /// The peer of a request. Nobody knows that of a request that came over no connection: it is
    /// treated as a stranger's.
    pub(super) fn of<B>(request: &Request<B>) -> Self {
        let nobody = SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), 0);
        request.extensions().get().copied().unwrap_or(Self {
            address: nobody,
            tls: false,
        })
    }

    /// Its address, in the form that people know: IPv4 also where it came through an IPv6 socket.
    pub(super) fn ip(self) -> IpAddr {
        self.address.ip().to_canonical()
    }

    /// Whether a program on this machine asks for itself. A proxy on this machine asks for others,
    /// and says so.
    pub(super) fn is_local(self, headers: &HeaderMap) -> bool {
        self.ip().is_loopback()
            && !headers.contains_key(header::FORWARDED)
            && !headers.contains_key("x-forwarded-for")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(address: &str) -> Peer {
        Peer {
            address: address.parse().expect("address"),
            tls: false,
        }
    }

    #[test]
    fn a_proxy_on_this_machine_is_not_this_machine() {
        let mut headers = HeaderMap::new();
        for local in ["127.0.0.1:5", "[::1]:5", "[::ffff:127.0.0.1]:5"] {
            assert!(peer(local).is_local(&headers), "{local}");
        }
        assert!(!peer("10.0.0.1:5").is_local(&headers));
        headers.insert("x-forwarded-for", "10.0.0.1".parse().expect("value"));
        assert!(!peer("127.0.0.1:5").is_local(&headers));
    }

    #[test]
    fn a_request_without_connection_is_a_strangers() {
        let mut request = Request::new(());
        assert!(!Peer::of(&request).ip().is_loopback());
        peer("127.0.0.1:5").mark(&mut request);
        assert_eq!(Peer::of(&request), peer("127.0.0.1:5"));
    }
}
