//! Where a running server is reached. It leaves that in its data directory for the console, which is not
//! told the server's options: a link that leads nowhere helps nobody.

use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::config::{Broker, BrokerUrl, Settings};

/// Name of the file in the data directory.
pub(crate) const ADDRESSES_FILE: &str = "addresses";

/// Where people and machines find a server.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Addresses {
    /// The control room.
    pub(crate) page: String,
    /// The broker, for a robot.
    pub(crate) robots: Endpoint,
    /// The broker, for a process of simulated robots.
    pub(crate) simulators: Endpoint,
}

/// A port of the broker.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Endpoint {
    pub(crate) host: String,
    pub(crate) port: u16,
    pub(crate) tls: bool,
}

impl Addresses {
    /// Where a server is by its options.
    pub(crate) fn by_options(settings: &Settings) -> Self {
        let (robots, simulators) = match (&settings.broker, settings.tls.mqtt_plain) {
            (Broker::Embedded(listen), plain) => {
                let main = Endpoint::of(*listen, settings.tls.covers(*listen));
                // Whoever opens a listener without TLS does it for boards.
                let robots = plain.map_or_else(|| main.clone(), |plain| Endpoint::of(plain, false));
                (robots, main)
            }
            (Broker::Outside(url), _) => {
                let outside = Endpoint {
                    host: url.host.clone(),
                    port: url.port,
                    tls: url.tls,
                };
                (outside.clone(), outside)
            }
        };
        Self {
            page: page(settings),
            robots,
            simulators,
        }
    }

    /// The same for a server that has bound its ports: `http`, and the one of `mqtt`. Without TLS it has
    /// no other listener; with it, `plain` is the port of that.
    pub(crate) fn bound(
        settings: &Settings,
        http: SocketAddr,
        mqtt: &BrokerUrl,
        plain: Option<u16>,
    ) -> Self {
        let mut settings = settings.clone();
        settings.http = http;
        if let Broker::Embedded(listen) = &mut settings.broker {
            listen.set_port(mqtt.port);
        }
        let listener = settings.tls.mqtt_plain.filter(|_| mqtt.tls).zip(plain);
        settings.tls.mqtt_plain = listener.map(|(listen, port)| SocketAddr::new(listen.ip(), port));
        Self::by_options(&settings)
    }

    /// What the server of these options has left in its data directory, or else what its options say.
    pub(crate) fn of(settings: &Settings) -> Self {
        fs::read(settings.data.join(ADDRESSES_FILE))
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_else(|| Self::by_options(settings))
    }

    /// Leaves them in the data directory, until what this returns is dropped.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn leave(&self, data: &Path) -> io::Result<LeftAddresses> {
        let new = data.join(format!("{ADDRESSES_FILE}.new"));
        fs::write(&new, serde_json::to_vec(self)?)?;
        let path = data.join(ADDRESSES_FILE);
        fs::rename(new, &path)?;
        Ok(LeftAddresses(path))
    }
}

/// The file with the addresses of a server; dropping this takes it away.
pub(crate) struct LeftAddresses(PathBuf);

impl Drop for LeftAddresses {
    fn drop(&mut self) {
        // Where it is missing, there is nothing to take away.
        let _ = fs::remove_file(&self.0);
    }
}

impl Endpoint {
    fn of(listen: SocketAddr, tls: bool) -> Self {
        Self {
            host: reachable(listen),
            port: listen.port(),
            tls,
        }
    }

    /// Whether only this machine reaches it.
    pub(crate) fn is_loopback(&self) -> bool {
        self.host == "localhost"
            || self
                .host
                .parse::<IpAddr>()
                .is_ok_and(|address| address.is_loopback())
    }
}

impl std::fmt::Display for Endpoint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.host.contains(':') {
            write!(f, "[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{}:{}", self.host, self.port)
        }
    }
}

/// The address of a listener as others would dial it.
fn reachable(listen: SocketAddr) -> String {
    if !listen.ip().is_unspecified() {
        return listen.ip().to_string();
    }
    own_address().map_or_else(|| "localhost".into(), |address| address.to_string())
}

/// The address from which this machine would reach others. Nothing is sent: connecting a UDP socket
/// only asks the routing table. The destination is from a block kept for documentation.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect("192.0.2.1:9").ok()?;
    let address = socket.local_addr().ok()?.ip();
    (!address.is_unspecified() && !address.is_loopback()).then_some(address)
}

/// Where a person finds the control room.
fn page(settings: &Settings) -> String {
    // Browsers refuse a certificate that is for another name.
    let named = settings.tls.names.as_slice().first().cloned();
    let host = named
        .filter(|_| !settings.http.ip().is_loopback())
        .unwrap_or_else(|| reachable(settings.http));
    let host = if host.contains(':') {
        format!("[{host}]")
    } else {
        host
    };
    let scheme = if settings.tls.covers(settings.http) {
        "https"
    } else {
        "http"
    };
    format!("{scheme}://{host}:{}/", settings.http.port())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Layer, Role};

    fn settings(layer: Layer) -> Settings {
        Settings::from_layers(Role::Serve, &[layer]).expect("settings")
    }

    #[test]
    fn an_address_that_stands_for_all_is_told_as_one() {
        let settings = settings(Layer {
            mqtt: Some("0.0.0.0:1883".parse().expect("address")),
            ..Layer::default()
        });
        let told = Addresses::by_options(&settings).robots;
        assert!(!told.host.starts_with("0."), "{told}");
    }

    #[test]
    fn ports_are_those_that_were_bound() {
        let settings = settings(Layer {
            http: Some("127.0.0.1:0".parse().expect("address")),
            mqtt: Some("10.1.2.3:0".parse().expect("address")),
            mqtt_plain: Some("10.1.2.3:0".parse().expect("address")),
            ..Layer::default()
        });
        let url = BrokerUrl {
            host: "127.0.0.1".into(),
            port: 4_002,
            credentials: None,
            tls: true,
        };
        let http = "127.0.0.1:4001".parse().expect("address");
        let told = Addresses::bound(&settings, http, &url, Some(4_003));
        assert_eq!(told.page, "http://127.0.0.1:4001/");
        assert_eq!(told.simulators.to_string(), "10.1.2.3:4002");
        assert!(told.simulators.tls && !told.robots.tls);
        assert_eq!(told.robots.to_string(), "10.1.2.3:4003");
    }
}
