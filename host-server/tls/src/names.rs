//! Under which names a server is reached.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use tokio_rustls::rustls::pki_types::DnsName;

/// Every name a certificate of ours is for: those of this machine, the addresses that `listeners`
/// have or are reached at, and `more`.
pub(crate) fn of(listeners: &[SocketAddr], more: &[String]) -> Vec<String> {
    let mut names = vec![
        "localhost".to_owned(),
        Ipv4Addr::LOCALHOST.to_string(),
        Ipv6Addr::LOCALHOST.to_string(),
    ];
    let mut add = |name: String| {
        if !names.contains(&name) {
            names.push(name);
        }
    };
    if let Some(host) = host_name() {
        // The name that machines in one room find each other by, unless it is a full one.
        if !host.contains('.') {
            add(format!("{host}.local"));
        }
        add(host);
    }
    for listener in listeners {
        match listener.ip() {
            ip if !ip.is_unspecified() => add(ip.to_canonical().to_string()),
            ip => {
                if let Some(own) = outward(ip) {
                    add(own.to_string());
                }
            }
        }
    }
    for name in more {
        add(name.clone());
    }
    names
}

fn host_name() -> Option<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname")
        .or_else(|_| std::env::var("HOSTNAME"))
        .ok()?;
    let name = name.trim().to_ascii_lowercase();
    let usable = DnsName::try_from(name.as_str()).is_ok() && name != "localhost";
    usable.then_some(name)
}

/// The address at which other machines most likely see this one. Nothing is sent: the system only
/// says from where it would. The other ends are of the ranges for documentation.
fn outward(listen: IpAddr) -> Option<IpAddr> {
    let far: IpAddr = match listen {
        IpAddr::V4(_) => Ipv4Addr::new(192, 0, 2, 1).into(),
        // A socket for both kinds is reached by IPv4 most of the time.
        IpAddr::V6(_) => return outward(Ipv4Addr::UNSPECIFIED.into()),
    };
    let socket = UdpSocket::bind(SocketAddr::new(listen, 0)).ok()?;
    socket.connect(SocketAddr::new(far, 9)).ok()?;
    let own = socket.local_addr().ok()?.ip();
    (!own.is_unspecified() && !own.is_loopback()).then_some(own)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_there_once() {
        let listeners = [
            "192.0.2.7:80".parse().expect("address"),
            "0.0.0.0:80".parse().expect("address"),
        ];
        let more = ["robots.example".to_owned(), "localhost".to_owned()];
        let names = of(&listeners, &more);
        for name in [
            "localhost",
            "127.0.0.1",
            "::1",
            "192.0.2.7",
            "robots.example",
        ] {
            let count = names.iter().filter(|known| *known == name).count();
            assert_eq!(count, 1, "{name} in {names:?}");
        }
        assert!(!names.contains(&"0.0.0.0".to_owned()), "{names:?}");
    }
}
