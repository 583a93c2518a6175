//! The address of a broker.

use std::fmt;
use std::str::FromStr;

/// `mqtt://[user[:password]@]host[:port]`.
#[derive(Clone, PartialEq, Eq)]
pub struct BrokerUrl {
    /// Host name or address, an IPv6 address in its brackets.
    pub host: String,
    /// TCP port; 1883 when none is written.
    pub port: u16,
    /// User name and password.
    pub credentials: Option<(String, String)>,
}

/// Why a text is not a broker's address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BrokerUrlError {
    /// No `mqtt://` in front.
    Scheme,
    /// TLS and WebSocket are not built in.
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
            Self::Scheme => "a broker is named like mqtt://host:1883",
            Self::Unsupported => "only mqtt:// is supported, not TLS or WebSocket",
            Self::Host => "the broker's host name is missing or not valid",
            Self::Port => "the broker's port is not a number from 1 to 65535",
            Self::Path => "nothing may follow the broker's host and port",
        })
    }
}

impl std::error::Error for BrokerUrlError {}

impl BrokerUrl {
    /// A broker of this machine.
    #[must_use]
    pub fn loopback(port: u16) -> Self {
        Self {
            host: "127.0.0.1".into(),
            port,
            credentials: None,
        }
    }
}

impl FromStr for BrokerUrl {
    type Err = BrokerUrlError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let Some(rest) = text.strip_prefix("mqtt://") else {
            let known = ["mqtts://", "ws://", "wss://", "ssl://"];
            return Err(if known.iter().any(|scheme| text.starts_with(scheme)) {
                BrokerUrlError::Unsupported
            } else {
                BrokerUrlError::Scheme
            });
        };
        let rest = rest.strip_suffix('/').unwrap_or(rest);
        let (credentials, address) = match rest.rsplit_once('@') {
            Some((who, address)) => {
                let (user, password) = who.split_once(':').unwrap_or((who, ""));
                (Some((user.to_owned(), password.to_owned())), address)
            }
            None => (None, rest),
        };
        if address.contains(['/', '?', '#']) {
            return Err(BrokerUrlError::Path);
        }
        let (host, port) = split_port(address)?;
        let port = match port {
            None => 1883,
            Some(text) => match text.parse::<u16>() {
                Ok(port) if port > 0 && text.bytes().all(|byte| byte.is_ascii_digit()) => port,
                Ok(_) | Err(_) => return Err(BrokerUrlError::Port),
            },
        };
        Ok(Self {
            host: host.to_owned(),
            port,
            credentials,
        })
    }
}

/// Host as it is dialled, and the port's text.
fn split_port(address: &str) -> Result<(&str, Option<&str>), BrokerUrlError> {
    if let Some(inner) = address.strip_prefix('[') {
        let (host, tail) = inner.split_once(']').ok_or(BrokerUrlError::Host)?;
        host.parse::<std::net::Ipv6Addr>()
            .map_err(|_| BrokerUrlError::Host)?;
        let bracketed = &address[..host.len() + 2];
        return match tail.strip_prefix(':') {
            Some(port) => Ok((bracketed, Some(port))),
            None if tail.is_empty() => Ok((bracketed, None)),
            None => Err(BrokerUrlError::Host),
        };
    }
    let (host, port) = match address.split_once(':') {
        Some((host, port)) => (host, Some(port)),
        None => (address, None),
    };
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'.' | b'_');
    if host.is_empty() || !host.bytes().all(plain) {
        return Err(BrokerUrlError::Host);
    }
    Ok((host, port))
}

impl fmt::Display for BrokerUrl {
    /// Without the password: the address ends up in reports.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.credentials {
            Some((user, _)) => write!(f, "mqtt://{user}@{}:{}", self.host, self.port),
            None => write!(f, "mqtt://{}:{}", self.host, self.port),
        }
    }
}

impl fmt::Debug for BrokerUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BrokerUrl({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        let full: BrokerUrl = "mqtt://ada:pass:word@robots.local:1884".parse().unwrap();
        assert_eq!((full.host.as_str(), full.port), ("robots.local", 1884));
        let credentials = Some(("ada".to_owned(), "pass:word".to_owned()));
        assert_eq!(full.credentials, credentials);
        let short: BrokerUrl = "mqtt://10.0.0.1/".parse().unwrap();
        assert_eq!((short.host.as_str(), short.port), ("10.0.0.1", 1883));
        let six: BrokerUrl = "mqtt://[::1]:9".parse().unwrap();
        assert_eq!((six.host.as_str(), six.port), ("[::1]", 9));
    }

    #[test]
    fn what_is_no_address_says_why() {
        for (text, error) in [
            ("robots.local:1883", BrokerUrlError::Scheme),
            ("mqtts://robots.local", BrokerUrlError::Unsupported),
            ("mqtt://", BrokerUrlError::Host),
            ("mqtt://a b", BrokerUrlError::Host),
            ("mqtt://::1", BrokerUrlError::Host),
            ("mqtt://[::1", BrokerUrlError::Host),
            ("mqtt://a:0", BrokerUrlError::Port),
            ("mqtt://a:+1", BrokerUrlError::Port),
            ("mqtt://a:70000", BrokerUrlError::Port),
            ("mqtt://a:1883/x", BrokerUrlError::Path),
        ] {
            assert_eq!(text.parse::<BrokerUrl>(), Err(error), "{text}");
        }
    }

    #[test]
    fn a_password_is_never_shown() {
        let url: BrokerUrl = "mqtt://ada:secret@host".parse().unwrap();
        assert_eq!(url.to_string(), "mqtt://ada@host:1883");
        assert!(!format!("{url:?}").contains("secret"));
    }
}
