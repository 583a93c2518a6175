//! Where the broker is.

use core::fmt;
use core::net::Ipv4Addr;
use core::str::FromStr;

use crawler_tls::Authority;
use heapless::String;

use super::Flaw;

/// Port of MQTT without TLS.
pub const BROKER_PORT: u16 = 1883;
/// Port of MQTT with TLS.
pub const SECURE_BROKER_PORT: u16 = 8883;
/// Longest host name, in bytes.
pub const MAX_HOST: usize = 64;
/// Longest part of a host name between two dots (RFC 1035, section 2.3.4).
const MAX_LABEL: usize = 63;

/// Host name or IPv4 address of the broker, its port, and how it proves who it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broker {
    /// Host name or IPv4 address.
    pub host: String<MAX_HOST>,
    /// TCP port; never 0.
    pub port: u16,
    /// Who has signed its certificate: with it everything is said over TLS, and nothing without.
    pub authority: Option<Authority>,
}

impl Broker {
    /// Checks a host and a port, without TLS.
    ///
    /// # Errors
    /// The [`Flaw`] of the one or the other.
    pub fn new(host: &str, port: u16) -> Result<Self, Flaw> {
        if port == 0 {
            return Err(Flaw::Port);
        }
        check_host(host)?;
        let host = String::try_from(host).map_err(|_| Flaw::TooLong)?;
        Ok(Self {
            host,
            port,
            authority: None,
        })
    }
}

/// Letters, digits, dashes and dots as in RFC 1123, section 2.1. What ends like a number has to be
/// an address, so that `192.168.1` or `10.0.0.256` is not sent to a name server.
fn check_host(host: &str) -> Result<(), Flaw> {
    if host.is_empty() {
        return Err(Flaw::Missing);
    }
    if host.len() > MAX_HOST {
        return Err(Flaw::TooLong);
    }
    let fits = |label: &str| {
        !label.is_empty()
            && label.len() <= MAX_LABEL
            && !label.starts_with('-')
            && !label.ends_with('-')
            && label
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'-')
    };
    if !host.split('.').all(fits) {
        return Err(Flaw::Host);
    }
    let last = host.rsplit('.').next().unwrap_or(host);
    if last.bytes().all(|byte| byte.is_ascii_digit()) && Ipv4Addr::from_str(host).is_err() {
        return Err(Flaw::Host);
    }
    Ok(())
}

impl FromStr for Broker {
    type Err = Flaw;

    /// Reads `host` or `host:port`.
    fn from_str(text: &str) -> Result<Self, Flaw> {
        match text.split_once(':') {
            None => Self::new(text, BROKER_PORT),
            Some((host, port)) => {
                // `parse` alone would take a plus sign.
                if !port.bytes().all(|byte| byte.is_ascii_digit()) {
                    return Err(Flaw::Port);
                }
                Self::new(host, port.parse().map_err(|_| Flaw::Port)?)
            }
        }
    }
}

impl fmt::Display for Broker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}
