//! The options of TLS.

use std::fmt;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;

use serde::Deserialize;

use super::{Broker, ConfigError, Layer, Role};

/// Most names that somebody may add to a certificate.
const MOST_NAMES: usize = 64;

/// Whether listeners speak TLS.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum TlsMode {
    /// None does.
    Off,
    /// All do.
    On,
    /// Those do that other machines can reach.
    #[default]
    Auto,
}

impl FromStr for TlsMode {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "off" => Ok(Self::Off),
            "on" => Ok(Self::On),
            "auto" => Ok(Self::Auto),
            _ => Err("must be `off`, `on` or `auto`"),
        }
    }
}

/// More names and addresses for the certificate that the server makes, separated by commas.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TlsNames(Vec<String>);

impl TlsNames {
    /// The names, in the order given.
    #[must_use]
    pub fn as_slice(&self) -> &[String] {
        &self.0
    }
}

/// Something that is neither a host name nor an address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoTlsName(String);

impl fmt::Display for NoTlsName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "`{}` is no host name or address; give at most {MOST_NAMES} of them, separated by commas",
            self.0
        )
    }
}

impl std::error::Error for NoTlsName {}

impl FromStr for TlsNames {
    type Err = NoTlsName;

    fn from_str(text: &str) -> Result<Self, NoTlsName> {
        let names: Vec<_> = text
            .split(',')
            .map(|name| name.trim().to_ascii_lowercase())
            .collect();
        match names.iter().find(|name| !is_name(name)) {
            Some(wrong) => Err(NoTlsName(wrong.clone())),
            None if names.len() > MOST_NAMES => Err(NoTlsName(format!("{} names", names.len()))),
            None => Ok(Self(names)),
        }
    }
}

fn is_name(name: &str) -> bool {
    let label = |label: &str| {
        (1..=63).contains(&label.len())
            && !label.starts_with('-')
            && !label.ends_with('-')
            && label
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
    };
    name.parse::<IpAddr>().is_ok() || (name.len() <= 253 && name.split('.').all(label))
}

impl<'de> Deserialize<'de> for TlsNames {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

/// The options of TLS, resolved.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TlsSettings {
    /// Whether listeners speak TLS.
    pub mode: TlsMode,
    /// More names for the certificate that the server makes.
    pub names: TlsNames,
    /// Certificate and key of the user instead: two PEM files.
    pub own: Option<(PathBuf, PathBuf)>,
    /// Authorities of the certificates that MQTT clients may show.
    pub client_ca: Option<PathBuf>,
    /// Where the embedded broker listens without TLS as well.
    pub mqtt_plain: Option<SocketAddr>,
    /// Authorities that an outside broker is trusted by, instead of those of this machine.
    pub broker_ca: Option<PathBuf>,
}

impl TlsSettings {
    /// Whether a listener at this address speaks TLS.
    #[must_use]
    pub fn covers(&self, listen: SocketAddr) -> bool {
        match self.mode {
            TlsMode::Off => false,
            TlsMode::On => true,
            TlsMode::Auto => !listen.ip().to_canonical().is_loopback(),
        }
    }

    pub(super) fn resolve(
        role: Role,
        merged: &Layer,
        broker: &Broker,
    ) -> Result<Self, ConfigError> {
        let own = match (&merged.tls_certificate, &merged.tls_key) {
            (Some(certificate), Some(key)) => Some((certificate.clone(), key.clone())),
            (None, None) => None,
            _ => {
                return Err(ConfigError::Conflict(
                    "`tls_certificate` and `tls_key` belong together: give both or neither",
                ));
            }
        };
        if own.is_some() && merged.tls_names.is_some() {
            return Err(ConfigError::Conflict(
                "`tls_names` is for the certificate that the server makes, and `tls_certificate` \
                 names another one: give one of the two",
            ));
        }
        let tls = Self {
            mode: merged.tls.unwrap_or_default(),
            names: merged.tls_names.clone().unwrap_or_default(),
            own,
            client_ca: merged.tls_client_ca.clone(),
            mqtt_plain: merged
                .mqtt_plain
                .filter(|_| matches!(role, Role::Up | Role::Serve)),
            broker_ca: merged.broker_ca.clone(),
        };
        match broker {
            Broker::Outside(url) if !url.tls && tls.broker_ca.is_some() => {
                Err(ConfigError::Conflict(
                    "`broker_ca` is for a broker with TLS: name it like mqtts://host:8883",
                ))
            }
            Broker::Embedded(listen) if tls.mqtt_plain.is_some() && !tls.covers(*listen) => {
                Err(ConfigError::Conflict(
                    "`mqtt_plain` is a second listener next to one with TLS, and that at `mqtt` \
                     has none",
                ))
            }
            _ => Ok(tls),
        }
    }
}
