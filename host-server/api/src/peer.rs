//! Whom a request came from, as far as the connection tells.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Request, header};
use axum::middleware::Next;
use axum::response::Response;

use crawler_system::address::Networks;

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

    fn behind(mut self, proxies: &Networks, headers: &HeaderMap) -> Self {
        if !proxies.contains(self.ip()) {
            return self;
        }
        let https = |value: &HeaderValue| value.as_bytes().eq_ignore_ascii_case(b"https");
        self.tls |= headers.get("x-forwarded-proto").is_some_and(https);
        let lines: Vec<&HeaderValue> = headers.get_all("x-forwarded-for").iter().collect();
        let lines = lines.into_iter().rev();
        let hops = lines.flat_map(|line| line.to_str().unwrap_or_default().rsplit(','));
        for hop in hops {
            let Ok(address) = hop.trim().parse::<IpAddr>() else {
                break;
            };
            self.address = SocketAddr::new(address, 0);
            if !proxies.contains(address) {
                break;
            }
        }
        self
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

/// Who asked a proxy, where that is one of ours: what the last of them says that is not one of ours
/// itself. What stands before that in the header anybody can have written.
pub(super) async fn see_through(
    State(proxies): State<Arc<Networks>>,
    mut request: Request<Body>,
    next: Next,
) -> Response {
    let peer = Peer::of(&request).behind(&proxies, request.headers());
    peer.mark(&mut request);
    next.run(request).await
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
    fn a_trusted_proxy_is_believed_and_nobody_before_it() {
        let proxies: Networks = "10.0.0.0/8".parse().expect("networks");
        let behind = |address: &str, lines: &[&str]| {
            let mut headers = HeaderMap::new();
            for line in lines {
                headers.append("x-forwarded-for", line.parse().expect("value"));
            }
            peer(address).behind(&proxies, &headers).ip().to_string()
        };
        for (address, lines, who) in [
            ("10.0.0.1:5", &["192.0.2.7"][..], "192.0.2.7"),
            ("10.0.0.1:5", &["1.2.3.4, 192.0.2.7, 10.0.0.2"], "192.0.2.7"),
            ("10.0.0.1:5", &["1.2.3.4", "192.0.2.7"], "192.0.2.7"),
            ("10.0.0.1:5", &["1.2.3.4, nonsense"], "10.0.0.1"),
            ("10.0.0.1:5", &[], "10.0.0.1"),
            ("192.0.2.9:5", &["1.2.3.4"], "192.0.2.9"),
        ] {
            assert_eq!(behind(address, lines), who, "{address} {lines:?}");
        }
        // A browser on this machine that comes through a proxy is not this machine asking.
        let mut headers = HeaderMap::new();
        headers.insert("x-forwarded-for", "127.0.0.1".parse().expect("value"));
        let local = peer("10.0.0.1:5").behind(&proxies, &headers);
        assert!(!local.is_local(&headers));
    }

    #[test]
    fn a_request_without_connection_is_a_strangers() {
        let mut request = Request::new(());
        assert!(!Peer::of(&request).ip().is_loopback());
        peer("127.0.0.1:5").mark(&mut request);
        assert_eq!(Peer::of(&request), peer("127.0.0.1:5"));
    }
}
