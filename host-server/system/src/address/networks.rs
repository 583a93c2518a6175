//! Addresses and networks.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

use serde::Deserialize;

/// More of them are a mistake.
const MOST: usize = 64;

/// Addresses and networks, separated by commas, like `10.0.0.5, 192.168.0.0/16, fd00::/8`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Networks(Vec<(IpAddr, u8)>);

/// Something that is neither an address nor a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoNetwork(String);

impl fmt::Display for NoNetwork {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "`{}` is no address or network like 10.0.0.5 or 10.0.0.0/8; give at most {MOST} of them, \
             separated by commas",
            self.0
        )
    }
}

impl std::error::Error for NoNetwork {}

impl Networks {
    /// Whether an address is one of them, or in one of them.
    #[must_use]
    pub fn contains(&self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        self.0
            .iter()
            .any(|&(network, length)| match (network, address) {
                (IpAddr::V4(network), IpAddr::V4(address)) => {
                    let mask = u32::MAX.checked_shl(32 - u32::from(length)).unwrap_or(0);
                    u32::from(network) & mask == u32::from(address) & mask
                }
                (IpAddr::V6(network), IpAddr::V6(address)) => {
                    let mask = u128::MAX.checked_shl(128 - u32::from(length)).unwrap_or(0);
                    u128::from(network) & mask == u128::from(address) & mask
                }
                _ => false,
            })
    }
}

impl FromStr for Networks {
    type Err = NoNetwork;

    fn from_str(text: &str) -> Result<Self, NoNetwork> {
        let network = |text: &str| {
            let wrong = || NoNetwork(text.to_owned());
            let (address, length) = match text.split_once('/') {
                Some((address, length)) => (address, Some(length)),
                None => (text, None),
            };
            let address: IpAddr = address.parse().map_err(|_| wrong())?;
            let longest = if address.is_ipv4() { 32 } else { 128 };
            let length: u8 = length
                .map_or(Ok(longest), str::parse)
                .map_err(|_| wrong())?;
            if length > longest {
                return Err(wrong());
            }
            Ok((address, length))
        };
        let all: Vec<_> = text
            .split(',')
            .map(|text| network(text.trim()))
            .collect::<Result<_, _>>()?;
        if all.len() > MOST {
            return Err(NoNetwork(format!("{} networks", all.len())));
        }
        Ok(Self(all))
    }
}

impl<'de> Deserialize<'de> for Networks {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_in_its_networks_alone() {
        let networks: Networks = "10.0.0.5, 192.168.0.0/16,fd00::/8"
            .parse()
            .expect("networks");
        let contains = |text: &str| networks.contains(text.parse().expect("an address"));
        for inside in ["10.0.0.5", "::ffff:10.0.0.5", "192.168.255.1", "fd12::1"] {
            assert!(contains(inside), "{inside}");
        }
        for outside in ["10.0.0.6", "192.169.0.1", "fe80::1", "::1"] {
            assert!(!contains(outside), "{outside}");
        }
        let all: Networks = "0.0.0.0/0".parse().expect("networks");
        assert!(all.contains([1, 2, 3, 4].into()));
        for wrong in [
            "",
            "10.0.0.0/33",
            "host",
            "10.0.0.1,",
            "10.0.0.0/-1",
            "::/129",
        ] {
            assert!(wrong.parse::<Networks>().is_err(), "{wrong}");
        }
    }
}
