//! Where an engine is, and how it is spoken to.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// Port when the address names none: `InfluxDB`'s.
const PORT: u16 = 8086;
/// Longest name of a database.
const MOST_DATABASE: usize = 200;

/// A language for questions about time series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dialect {
    /// `InfluxDB`'s of version 1, which later ones answer as well.
    InfluxQl,
    /// That of `VictoriaMetrics`, over `PromQL`.
    MetricsQl,
}

/// In which language questions are asked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Read {
    /// In the one that the engine is found to speak.
    #[default]
    Detect,
    /// In this one.
    In(Dialect),
    /// Not at all.
    Nothing,
}

/// The address of an engine: `influx://user:password@host:8086/database?token=…&read=…&ca=…`, or
/// `influxs://` with TLS. What is no letter or digit in user, password and token is written as `%XX`
/// where it would end them.
#[derive(Clone, PartialEq, Eq)]
pub struct Address {
    pub(crate) tls: bool,
    pub(crate) host: String,
    pub(crate) port: u16,
    pub(crate) database: String,
    /// What the header `Authorization` says.
    pub(crate) authorization: Option<String>,
    pub(crate) read: Read,
    /// PEM file of who vouches for the engine; those that this machine trusts when not given.
    pub(crate) ca: Option<PathBuf>,
}

/// The text is no address of an engine; says why.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoAddress(&'static str);

impl fmt::Display for NoAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

impl std::error::Error for NoAddress {}

/// With `%XX` replaced by what it stands for.
fn decoded(text: &str) -> Result<String, NoAddress> {
    const BAD: NoAddress = NoAddress("a `%` in the address must begin a `%XX` of UTF-8");
    let mut out = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte != b'%' {
            out.push(byte);
            continue;
        }
        let (digits, after) = rest.split_at_checked(2).ok_or(BAD)?;
        let digit = |byte: u8| char::from(byte).to_digit(16).ok_or(BAD);
        out.push((digit(digits[0])? << 4 | digit(digits[1])?) as u8);
        rest = after;
    }
    String::from_utf8(out).map_err(|_| BAD)
}

/// As part of a query string: everything else than letters, digits and `-_.~` as `%XX`.
pub(crate) fn encoded(text: &str) -> String {
    const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    let mut out = String::with_capacity(text.len() + text.len() / 2);
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
            out.push(byte.into());
        } else {
            out.push('%');
            out.push(DIGITS[usize::from(byte >> 4)].into());
            out.push(DIGITS[usize::from(byte & 0xf)].into());
        }
    }
    out
}

/// Host and port; an IPv6 address is in brackets.
fn place(text: &str) -> Result<(String, u16), NoAddress> {
    let (host, port) = match text.strip_prefix('[') {
        Some(inside) => {
            let (host, port) = inside
                .split_once(']')
                .ok_or(NoAddress("an IPv6 address ends with `]`"))?;
            (host, port.strip_prefix(':'))
        }
        None => match text.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (text, None),
        },
    };
    let known = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.:".contains(&byte);
    if host.is_empty() || !host.bytes().all(known) {
        return Err(NoAddress("the address must name a host"));
    }
    let port = port.map_or(Ok(PORT), |port| {
        port.parse()
            .map_err(|_| NoAddress("the port must be a number up to 65535"))
    })?;
    Ok((host.to_owned(), port))
}

impl FromStr for Address {
    type Err = NoAddress;

    fn from_str(text: &str) -> Result<Self, NoAddress> {
        let (scheme, rest) = text.split_once("://").unwrap_or_default();
        let tls = match scheme {
            "influx" => false,
            "influxs" => true,
            _ => {
                return Err(NoAddress(
                    "must be an address like influx://host:8086/database",
                ));
            }
        };
        let (rest, query) = rest.split_once('?').unwrap_or((rest, ""));
        // A password may have an `@`; a host has none.
        let (login, rest) = match rest.rsplit_once('@') {
            Some((login, rest)) => (Some(login), rest),
            None => (None, rest),
        };
        let (at, database) = rest.split_once('/').unwrap_or((rest, ""));
        let (host, port) = place(at)?;
        let database = decoded(database)?;
        if database.is_empty()
            || database.len() > MOST_DATABASE
            || database.contains(|c: char| c.is_control() || c == '/')
        {
            return Err(NoAddress(
                "the address must name a database, like influx://host:8086/database",
            ));
        }
        let mut authorization = match login {
            None => None,
            Some(login) => {
                let (user, password) = login.split_once(':').unwrap_or((login, ""));
                let both = format!("{}:{}", decoded(user)?, decoded(password)?);
                Some(format!("Basic {}", STANDARD.encode(both)))
            }
        };
        let (mut read, mut ca) = (Read::Detect, None);
        for part in query.split('&').filter(|part| !part.is_empty()) {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            let value = decoded(value)?;
            match key {
                "token" if authorization.is_some() => {
                    return Err(NoAddress("the address has a user or a token, not both"));
                }
                "token" => {
                    let visible = |byte: u8| (b'!'..=b'~').contains(&byte);
                    if value.is_empty() || !value.bytes().all(visible) {
                        return Err(NoAddress("`token` must be of visible ASCII characters"));
                    }
                    authorization = Some(format!("Token {value}"));
                }
                "read" => {
                    read = match value.as_str() {
                        "influxql" => Read::In(Dialect::InfluxQl),
                        "metricsql" => Read::In(Dialect::MetricsQl),
                        "none" => Read::Nothing,
                        _ => {
                            return Err(NoAddress(
                                "`read` must be `influxql`, `metricsql` or `none`",
                            ));
                        }
                    }
                }
                "ca" if tls && !value.is_empty() => ca = Some(PathBuf::from(value)),
                "ca" => return Err(NoAddress("`ca` names a file, for influxs:// alone")),
                _ => {
                    return Err(NoAddress(
                        "the address knows the parameters `token`, `read` and `ca` alone",
                    ));
                }
            }
        }
        Ok(Self {
            tls,
            host,
            port,
            database,
            authorization,
            read,
            ca,
        })
    }
}

impl Address {
    /// The host, with brackets around an IPv6 address, and the port.
    pub(crate) fn authority(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }
}

/// Without user, password and token, since addresses are printed and logged.
impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = if self.tls { "s" } else { "" };
        write!(f, "influx{s}://{}/{}", self.authority(), self.database)
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parsed(text: &str) -> Address {
        text.parse()
            .unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    #[test]
    fn all_of_an_address_is_read_and_little_is_shown() {
        let address = parsed("influxs://ada:p%40s%3as@db.example:1234/fleet?read=influxql&ca=/ca");
        assert_eq!(address.to_string(), "influxs://db.example:1234/fleet");
        assert_eq!(format!("{address:?}"), address.to_string());
        assert_eq!(address.read, Read::In(Dialect::InfluxQl));
        assert_eq!(address.ca, Some("/ca".into()));
        let basic = format!("Basic {}", STANDARD.encode("ada:p@s:s"));
        assert_eq!(address.authorization, Some(basic));

        let address = parsed("influx://[::1]/my%20fleet?token=a%3D");
        assert_eq!(address.authority(), "[::1]:8086");
        assert_eq!(address.database, "my fleet");
        assert_eq!(address.authorization.as_deref(), Some("Token a="));
        // As people write it who do not know of `%40`.
        let address = parsed("influx://ada:p@ss@host/d");
        assert_eq!(address.host, "host");
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, says) in [
            ("http://host/d", "influx://host"),
            ("influx://host", "a database"),
            ("influx://host/", "a database"),
            ("influx://host/a/b", "a database"),
            ("influx:///d", "a host"),
            ("influx://:8086/d", "a host"),
            ("influx://host:x/d", "port"),
            ("influx://host:99999/d", "port"),
            ("influx://[::1/d", "`]`"),
            ("influx://host/d%", "%XX"),
            ("influx://host/d%zz", "%XX"),
            ("influx://host/d?reed=influxql", "parameters"),
            ("influx://host/d?read=sql", "influxql"),
            ("influx://host/d?ca=x", "influxs"),
            ("influx://a@host/d?token=x", "not both"),
            ("influx://host/d?token=", "visible"),
            ("influx://host/d?token=%0a", "visible"),
        ] {
            let error = text.parse::<Address>().expect_err(text).to_string();
            assert!(error.contains(says), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded(text in any::<String>()) {
            let there = encoded(&text);
            prop_assert!(there.is_ascii());
            prop_assert_eq!(decoded(&there), Ok(text));
        }

        #[test]
        fn any_text_is_an_address_or_refused(text in "(influxs?://)?[ -~é]{0,60}") {
            let _ = text.parse::<Address>();
        }
    }
}
