//! The address of an outside broker.

use std::fmt;
use std::str::FromStr;

/// `mqtt://[user[:password]@]host[:port]`, or `mqtts://` for TLS.
#[derive(Clone, PartialEq, Eq)]
pub struct BrokerUrl {
    /// Host name or address, an IPv6 address without its brackets.
    pub host: String,
    /// TCP port; when none is written 1883, or 8883 for TLS.
    pub port: u16,
    /// User name and password.
    pub credentials: Option<(String, String)>,
    /// Whether the connection is encrypted.
    pub tls: bool,
}

/// Why a text is not a broker's address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BrokerUrlError {
    /// Neither `mqtt://` nor `mqtts://` in front.
    Scheme,
    /// `ws://` and `wss://` are not built in.
    Unsupported,
    /// No host, or one with characters no host has.
    Host,
    /// The port is not a number from 1 to 65535.
    Port,
    /// Something follows the port.
    Path,
}

impl fmt::Display for BrokerUrlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Scheme => "a broker is named like mqtt://host:1883 or mqtts://host:8883",
            Self::Unsupported => "only mqtt:// and mqtts:// are supported, not WebSocket",
            Self::Host => "the host name is missing or not valid",
            Self::Port => "the port is not a number from 1 to 65535",
            Self::Path => "nothing may follow host and port",
        })
    }
}

impl std::error::Error for BrokerUrlError {}

impl BrokerUrl {
    /// The broker of this machine at the usual port.
    #[must_use]
    pub fn loopback() -> Self {
        Self {
            host: "127.0.0.1".into(),
            port: 1883,
            credentials: None,
            tls: false,
        }
    }
}

impl FromStr for BrokerUrl {
    type Err = BrokerUrlError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (rest, tls) = match text.split_once("://") {
            Some(("mqtt", rest)) => (rest, false),
            Some(("mqtts", rest)) => (rest, true),
            Some(("ws" | "wss", _)) => return Err(BrokerUrlError::Unsupported),
            _ => return Err(BrokerUrlError::Scheme),
        };
        let rest = rest.strip_suffix('/').unwrap_or(rest);
        let (credentials, address) = match rest.rsplit_once('@') {
            Some((user, address)) => {
                let (name, password) = user.split_once(':').unwrap_or((user, ""));
                (Some((name.to_owned(), password.to_owned())), address)
            }
            None => (None, rest),
        };
        if address.contains(['/', '?', '#']) {
            return Err(BrokerUrlError::Path);
        }
        let (host, port) = if let Some(inner) = address.strip_prefix('[') {
            let (host, tail) = inner.split_once(']').ok_or(BrokerUrlError::Host)?;
            let port = match tail.strip_prefix(':') {
                Some(port) => Some(port),
                None if tail.is_empty() => None,
                None => return Err(BrokerUrlError::Host),
            };
            host.parse::<std::net::Ipv6Addr>()
                .map_err(|_| BrokerUrlError::Host)?;
            (host, port)
        } else {
            match address.split_once(':') {
                Some((host, port)) => (host, Some(port)),
                None => (address, None),
            }
        };
        let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_' | ':');
        if host.is_empty() || host.len() > 253 || !host.chars().all(legal) {
            return Err(BrokerUrlError::Host);
        }
        let port = match port {
            None if tls => 8883,
            None => 1883,
            Some(text) => text
                .parse::<u16>()
                .ok()
                .filter(|port| *port > 0)
                .ok_or(BrokerUrlError::Port)?,
        };
        Ok(Self {
            host: host.to_owned(),
            port,
            credentials,
            tls,
        })
    }
}

/// Without the password: the address is printed and logged.
impl fmt::Display for BrokerUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.tls { "mqtts" } else { "mqtt" };
        if self.host.contains(':') {
            write!(f, "{scheme}://[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{scheme}://{}:{}", self.host, self.port)
        }
    }
}

impl fmt::Debug for BrokerUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl<'de> serde::Deserialize<'de> for BrokerUrl {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}
