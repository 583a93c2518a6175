//! Where a server is, as people write it.

use std::fmt;
use std::str::FromStr;

use hyper::Uri;

/// `http://HOST[:PORT]`, or `https://` for TLS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ServerUrl {
    /// Host name or address, an IPv6 address without its brackets.
    pub(crate) host: String,
    /// TCP port; when none is written 80, or 443 for TLS.
    pub(crate) port: u16,
    /// Whether the connection is encrypted.
    pub(crate) tls: bool,
}

/// A text that is no address of a server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct NoServerUrl;

impl fmt::Display for NoServerUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a server is named like http://127.0.0.1:8080 or https://rover.example:8443")
    }
}

impl std::error::Error for NoServerUrl {}

impl ServerUrl {
    /// What a request names as its host.
    pub(super) fn authority(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }
}

impl FromStr for ServerUrl {
    type Err = NoServerUrl;

    fn from_str(text: &str) -> Result<Self, NoServerUrl> {
        let uri: Uri = text.parse().map_err(|_| NoServerUrl)?;
        let tls = match uri.scheme_str() {
            Some("http") => false,
            Some("https") => true,
            _ => return Err(NoServerUrl),
        };
        let authority = uri.authority().ok_or(NoServerUrl)?;
        let host = authority.host();
        let bare = match host.strip_prefix('[') {
            Some(rest) => rest.strip_suffix(']').ok_or(NoServerUrl)?,
            None => host,
        };
        // A password is asked for, and does not belong here; nothing follows the port but a slash.
        let plain = authority.as_str() == host
            || authority
                .as_str()
                .strip_prefix(host)
                .is_some_and(|rest| rest.starts_with(':'));
        if bare.is_empty() || !plain || uri.path() != "/" || uri.query().is_some() {
            return Err(NoServerUrl);
        }
        let port = match authority.as_str().strip_prefix(host).unwrap_or_default() {
            "" => {
                if tls {
                    443
                } else {
                    80
                }
            }
            _ => authority
                .port_u16()
                .filter(|port| *port > 0)
                .ok_or(NoServerUrl)?,
        };
        Ok(Self {
            host: bare.to_owned(),
            port,
            tls,
        })
    }
}

impl fmt::Display for ServerUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.tls { "https" } else { "http" };
        write!(f, "{scheme}://{}/", self.authority())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn servers_are_named_by_scheme_host_and_port() {
        for (text, shown) in [
            ("http://127.0.0.1:8080", Some("http://127.0.0.1:8080/")),
            ("http://localhost/", Some("http://localhost:80/")),
            ("https://rover.example", Some("https://rover.example:443/")),
            ("https://[::1]:8443/", Some("https://[::1]:8443/")),
            ("", None),
            ("rover.example", None),
            ("rover.example:8080", None),
            ("ftp://rover.example", None),
            ("http://", None),
            ("http:///", None),
            ("http://:80", None),
            ("http://a:", None),
            ("http://a:0", None),
            ("http://a:65536", None),
            ("http://a:b", None),
            ("http://ada:secret@a", None),
            ("http://a/api", None),
            ("http://a?b", None),
            ("http://a b", None),
            ("http://[::1", None),
        ] {
            let read = text.parse::<ServerUrl>().ok();
            assert_eq!(read.map(|url| url.to_string()).as_deref(), shown, "{text}");
        }
    }
}
