//! Settings as bytes: fields of one tag byte, one length byte and the value.
//!
//! A reader skips tags it does not know: after a step back to an older program, which knows fewer
//! settings, the robot must still find its network.

use core::fmt;

use crawler_protocol::{Fleet, RobotId};
use crawler_tls::Authority;

use super::{
    AccessPointPassword, Broker, Kept, Passphrase, RangerMode, Settings, Ssid, Wifi, credentials,
};

const ACCESS_POINT_PASSWORD: u8 = 1;
const SSID: u8 = 2;
const PASSPHRASE: u8 = 3;
const BROKER_HOST: u8 = 4;
const BROKER_PORT: u8 = 5;
const FLEET: u8 = 6;
const ID: u8 = 7;
const USERNAME: u8 = 8;
const PASSWORD: u8 = 9;
const RANGER: u8 = 10;
const AUTHORITY: u8 = 11;
/// Tags known to this program, and the unused 0.
const TAGS: usize = 12;

/// Longest encoded form: each field at its longest, with its tag and length.
pub(super) const ENCODED_MAX: usize =
    2 * (TAGS - 1) + 14 + 32 + 64 + 64 + 2 + 32 + 32 + 32 + 64 + 1 + 33;

/// Bytes that pass their checksum and are not settings all the same: an older or broken program
/// wrote them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeError {
    /// A field reaches beyond the end.
    Truncated,
    /// A field stands twice.
    Twice,
    /// A field has a value that it cannot have.
    Value,
    /// A field that has to be there is not.
    Absent,
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Truncated => "stored settings are cut off",
            Self::Twice => "stored settings name a field twice",
            Self::Value => "stored settings hold an impossible value",
            Self::Absent => "stored settings lack a field",
        })
    }
}

impl core::error::Error for DecodeError {}

/// Writes fields one after the other.
struct Writer<'a> {
    out: &'a mut [u8; ENCODED_MAX],
    len: usize,
}

impl Writer<'_> {
    /// Every value fits by its type, so that nothing is ever left out here; a test encodes the
    /// longest of all.
    fn field(&mut self, tag: u8, value: &[u8]) {
        let (Ok(length), Some(place)) = (
            u8::try_from(value.len()),
            self.out.get_mut(self.len..self.len + 2 + value.len()),
        ) else {
            return;
        };
        place[0] = tag;
        place[1] = length;
        place[2..].copy_from_slice(value);
        self.len += place.len();
    }
}

/// Encodes what is kept; returns the part of `out` that was written.
pub(super) fn encode<'a>(kept: &Kept, out: &'a mut [u8; ENCODED_MAX]) -> &'a [u8] {
    let mut writer = Writer { out, len: 0 };
    if let Some(password) = &kept.access_point {
        writer.field(ACCESS_POINT_PASSWORD, password.reveal().as_bytes());
    }
    if let Some(settings) = &kept.settings {
        if let Some(wifi) = &settings.wifi {
            writer.field(SSID, wifi.ssid.as_str().as_bytes());
            if let Some(passphrase) = &wifi.passphrase {
                writer.field(PASSPHRASE, passphrase.reveal().as_bytes());
            }
        }
        writer.field(BROKER_HOST, settings.broker.host.as_bytes());
        writer.field(BROKER_PORT, &settings.broker.port.to_le_bytes());
        if let Some(authority) = &settings.broker.authority {
            writer.field(AUTHORITY, authority.as_bytes());
        }
        writer.field(FLEET, settings.fleet.as_str().as_bytes());
        writer.field(ID, settings.id.as_str().as_bytes());
        if let Some(credentials) = &settings.credentials {
            writer.field(USERNAME, credentials.username.as_bytes());
            writer.field(PASSWORD, credentials.password.as_bytes());
        }
        let ranger = match settings.ranger {
            RangerMode::Uart => b"u",
            RangerMode::Pulse => b"p",
        };
        writer.field(RANGER, ranger);
    }
    let len = writer.len;
    &out[..len]
}

/// Reads what [`encode`] wrote.
pub(super) fn decode(mut bytes: &[u8]) -> Result<Kept, DecodeError> {
    let mut fields: [Option<&[u8]>; TAGS] = [None; TAGS];
    while let Some((&tag, rest)) = bytes.split_first() {
        let (&length, rest) = rest.split_first().ok_or(DecodeError::Truncated)?;
        let (value, rest) = rest
            .split_at_checked(usize::from(length))
            .ok_or(DecodeError::Truncated)?;
        bytes = rest;
        let Some(field) = fields.get_mut(usize::from(tag)) else {
            continue;
        };
        if field.replace(value).is_some() {
            return Err(DecodeError::Twice);
        }
    }
    let text = |tag: u8| {
        fields[usize::from(tag)]
            .map(|value| core::str::from_utf8(value).map_err(|_| DecodeError::Value))
            .transpose()
    };
    let access_point = text(ACCESS_POINT_PASSWORD)?
        .map(AccessPointPassword::new)
        .transpose()
        .map_err(|_| DecodeError::Value)?;
    let Some(host) = text(BROKER_HOST)? else {
        // Without a broker there are no settings, and so no part of them.
        let rest = SSID..TAGS as u8;
        return if rest
            .into_iter()
            .all(|tag| fields[usize::from(tag)].is_none())
        {
            Ok(Kept {
                settings: None,
                access_point,
            })
        } else {
            Err(DecodeError::Absent)
        };
    };
    let port: [u8; 2] = fields[usize::from(BROKER_PORT)]
        .ok_or(DecodeError::Absent)?
        .try_into()
        .map_err(|_| DecodeError::Value)?;
    let wifi = match (text(SSID)?, text(PASSPHRASE)?) {
        (None, None) => None,
        (None, Some(_)) => return Err(DecodeError::Absent),
        (Some(ssid), passphrase) => Some(Wifi {
            ssid: Ssid::new(ssid).map_err(|_| DecodeError::Value)?,
            passphrase: passphrase
                .map(Passphrase::new)
                .transpose()
                .map_err(|_| DecodeError::Value)?,
        }),
    };
    let credentials = match (text(USERNAME)?, text(PASSWORD)?) {
        (None, None) => None,
        (Some(name), Some(password)) => {
            Some(credentials(name, password).map_err(|_| DecodeError::Value)?)
        }
        (Some(_), None) | (None, Some(_)) => return Err(DecodeError::Absent),
    };
    let ranger = match fields[usize::from(RANGER)] {
        None | Some(b"u") => RangerMode::Uart,
        Some(b"p") => RangerMode::Pulse,
        Some(_) => return Err(DecodeError::Value),
    };
    let mut broker = Broker::new(host, u16::from_le_bytes(port)).map_err(|_| DecodeError::Value)?;
    // One that cannot be read must not turn into none: then nothing would be encrypted.
    broker.authority = fields[usize::from(AUTHORITY)]
        .map(|bytes| {
            let bytes = bytes.try_into().map_err(|_| DecodeError::Value)?;
            Authority::new(bytes).map_err(|_| DecodeError::Value)
        })
        .transpose()?;
    let name = |tag| text(tag)?.ok_or(DecodeError::Absent);
    Ok(Kept {
        settings: Some(Settings {
            wifi,
            broker,
            fleet: Fleet::new(name(FLEET)?).map_err(|_| DecodeError::Value)?,
            id: RobotId::new(name(ID)?).map_err(|_| DecodeError::Value)?,
            credentials,
            ranger,
        }),
        access_point,
    })
}
