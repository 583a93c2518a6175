//! Whom a certificate is for (RFC 9525): the names among its alternative names.

use core::net::IpAddr;

use crate::der::Der;
use crate::error::TlsError;

/// Alternative names: context-specific tags of RFC 5280, section 4.2.1.6.
const DNS: u8 = 0x82;
const ADDRESS: u8 = 0x87;
/// Longest name in DNS.
const MAX_HOST: usize = 253;

/// The host that was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Name<'a> {
    Host(&'a str),
    Address(IpAddr),
}

impl<'a> Name<'a> {
    pub(crate) fn new(host: &'a str) -> Result<Self, TlsError> {
        if let Ok(address) = host.parse() {
            return Ok(Self::Address(address));
        }
        // A dot at the end says that a name is complete, and is not part of it.
        let host = host.strip_suffix('.').unwrap_or(host);
        let fits = |label: &str| {
            (1..=63).contains(&label.len())
                && label
                    .bytes()
                    .all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_'))
        };
        if host.len() > MAX_HOST || !host.split('.').all(fits) {
            return Err(TlsError::Unusable);
        }
        Ok(Self::Host(host))
    }

    /// Whether one of the alternative names in `san` is this one.
    pub(crate) fn is_among(self, san: &[u8]) -> Result<bool, TlsError> {
        let mut outer = Der(san);
        let mut names = outer.sequence()?;
        outer.end()?;
        let mut found = false;
        while !names.is_empty() {
            let name = names.next()?;
            found |= match (name.tag, self) {
                (DNS, Self::Host(host)) => covers(name.content, host),
                (ADDRESS, Self::Address(IpAddr::V4(own))) => name.content == own.octets(),
                (ADDRESS, Self::Address(IpAddr::V6(own))) => name.content == own.octets(),
                _ => false,
            };
        }
        Ok(found)
    }
}

/// Whether a name in a certificate covers a host: the same, or with a star for its first label.
fn covers(pattern: &[u8], host: &str) -> bool {
    let host = host.as_bytes();
    if let Some(parent) = pattern.strip_prefix(b"*.") {
        let Some(dot) = host.iter().position(|byte| *byte == b'.') else {
            return false;
        };
        // Below a name of one label there would be half of the internet.
        return parent.contains(&b'.')
            && host
                .get(dot + 1..)
                .is_some_and(|rest| rest.eq_ignore_ascii_case(parent));
    }
    !pattern.is_empty() && pattern.eq_ignore_ascii_case(host)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cover_what_they_should() {
        for (pattern, host, covered) in [
            ("broker.lan", "broker.lan", true),
            ("Broker.LAN", "broker.lan", true),
            ("broker.lan", "broker.lan.", true),
            ("broker", "broker.lan", false),
            ("*.robots.lan", "a.robots.lan", true),
            ("*.robots.lan", "robots.lan", false),
            ("*.robots.lan", "a.b.robots.lan", false),
            ("*.lan", "broker.lan", false),
            ("*", "broker", false),
            ("*.", "broker.", false),
            ("b*.robots.lan", "broker.robots.lan", false),
            ("", "broker", false),
        ] {
            let Ok(Name::Host(host)) = Name::new(host) else {
                panic!("{host} is a name")
            };
            assert_eq!(
                covers(pattern.as_bytes(), host),
                covered,
                "{pattern} {host}"
            );
        }
    }

    #[test]
    fn hosts_are_names_or_addresses() {
        assert!(matches!(Name::new("10.0.2.2"), Ok(Name::Address(_))));
        assert!(matches!(Name::new("::1"), Ok(Name::Address(_))));
        for bad in ["", ".", "a..b", "ä.lan", "a b", "mqtts://a", "*.lan"] {
            assert_eq!(Name::new(bad), Err(TlsError::Unusable), "{bad}");
        }
        let long = "a.".repeat(127);
        assert_eq!(Name::new(&long), Ok(Name::Host(&long[..253])));
        assert!(Name::new(&"a.".repeat(128)).is_err());
    }

    #[test]
    fn an_address_is_compared_as_an_address() {
        let san = [0x30, 6, ADDRESS, 4, 10, 0, 2, 2];
        let asked = |host| Name::new(host).unwrap().is_among(&san);
        assert_eq!(asked("10.0.2.2"), Ok(true));
        assert_eq!(asked("10.0.2.3"), Ok(false));
        // As text it is no address of a certificate.
        let text = b"\x30\x0a\x82\x0810.0.2.2";
        assert_eq!(Name::new("10.0.2.2").unwrap().is_among(text), Ok(false));
        assert_eq!(asked("10.0.2.2.example"), Ok(false));
        let cut = [0x30, 6, ADDRESS, 5, 10, 0, 2, 2];
        let cut = Name::new("10.0.2.2").unwrap().is_among(&cut);
        assert_eq!(cut, Err(TlsError::BadCertificate));
    }
}
