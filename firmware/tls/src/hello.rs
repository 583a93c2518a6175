//! The first message of each side (RFC 8446, section 4.1).

use crate::error::TlsError;
use crate::keys::HASH;
use crate::name::Name;
use crate::reader::{Reader, Writer};
use crate::sizes::FRAGMENT;
use crate::sizes::POINT;

pub(crate) const CLIENT_HELLO: u8 = 1;

const LEGACY_VERSION: u16 = 0x0303;
const VERSION: u16 = 0x0304;
const CHACHA20_POLY1305_SHA256: u16 = 0x1303;
const SECP256R1: u16 = 23;
pub(crate) const ECDSA_SECP256R1_SHA256: u16 = 0x0403;

/// Extensions, by their numbers at IANA.
const SERVER_NAME: u16 = 0;
const MAX_FRAGMENT_LENGTH: u16 = 1;
const SUPPORTED_GROUPS: u16 = 10;
const SIGNATURE_ALGORITHMS: u16 = 13;
const RECORD_SIZE_LIMIT: u16 = 28;
const SUPPORTED_VERSIONS: u16 = 43;
const KEY_SHARE: u16 = 51;

/// The code of [`FRAGMENT`] in `max_fragment_length` (RFC 6066, section 4).
const FRAGMENT_CODE: u8 = 3;
const _: () = assert!(FRAGMENT == 256 << FRAGMENT_CODE);
/// A record with its type (RFC 8449, section 4).
const RECORD_LIMIT: u16 = FRAGMENT as u16 + 1;
/// Least limit that the other side may set (RFC 8449, section 4).
const LEAST_LIMIT: u16 = 64;

/// The random number that makes a `ServerHello` a `HelloRetryRequest` (section 4.1.3).
const RETRY: [u8; 32] = [
    0xCF, 0x21, 0xAD, 0x74, 0xE5, 0x9A, 0x61, 0x11, 0xBE, 0x1D, 0x8C, 0x02, 0x1E, 0x65, 0xB8, 0x91,
    0xC2, 0xA2, 0x11, 0x16, 0x7A, 0xBB, 0x8C, 0x5E, 0x07, 0x9E, 0x09, 0xE2, 0xC8, 0xA8, 0x33, 0x9C,
];

/// Writes a `ClientHello`; its length.
///
/// The session identifier is empty: there is no middlebox to be fooled between a robot and its
/// broker, and the server sends no compatibility message then.
pub(crate) fn write(
    out: &mut [u8],
    random: &[u8; HASH],
    name: Name<'_>,
    share: &[u8],
) -> Result<usize, TlsError> {
    let mut w = Writer::new(out);
    w.put(&[CLIENT_HELLO])?;
    w.counted(3, |w| {
        w.u16(LEGACY_VERSION)?;
        w.put(random)?;
        w.counted(1, |_| Ok(()))?;
        w.counted(2, |w| w.u16(CHACHA20_POLY1305_SHA256))?;
        w.counted(1, |w| w.put(&[0]))?;
        w.counted(2, |w| extensions(w, name, share))
    })?;
    Ok(w.len())
}

fn extensions(w: &mut Writer<'_>, name: Name<'_>, share: &[u8]) -> Result<(), TlsError> {
    // Addresses have no place in it (RFC 6066, section 3).
    if let Name::Host(host) = name {
        w.u16(SERVER_NAME)?;
        w.counted(2, |w| {
            w.counted(2, |w| {
                w.put(&[0])?;
                w.counted(2, |w| w.put(host.as_bytes()))
            })
        })?;
    }
    w.u16(MAX_FRAGMENT_LENGTH)?;
    w.counted(2, |w| w.put(&[FRAGMENT_CODE]))?;
    w.u16(RECORD_SIZE_LIMIT)?;
    w.counted(2, |w| w.u16(RECORD_LIMIT))?;
    w.u16(SUPPORTED_GROUPS)?;
    w.counted(2, |w| w.counted(2, |w| w.u16(SECP256R1)))?;
    w.u16(SIGNATURE_ALGORITHMS)?;
    w.counted(2, |w| w.counted(2, |w| w.u16(ECDSA_SECP256R1_SHA256)))?;
    w.u16(SUPPORTED_VERSIONS)?;
    w.counted(2, |w| w.counted(1, |w| w.u16(VERSION)))?;
    w.u16(KEY_SHARE)?;
    w.counted(2, |w| {
        w.counted(2, |w| {
            w.u16(SECP256R1)?;
            w.counted(2, |w| w.put(share))
        })
    })
}

/// What is wrong with an extension of the server that has no place in its message (section 4.2): that it
/// was not offered at all, or that it belongs elsewhere.
const fn misplaced(kind: u16, name: Name<'_>) -> TlsError {
    match kind {
        SERVER_NAME if matches!(name, Name::Address(_)) => TlsError::Extension,
        SERVER_NAME | MAX_FRAGMENT_LENGTH | SUPPORTED_GROUPS | SIGNATURE_ALGORITHMS
        | RECORD_SIZE_LIMIT | SUPPORTED_VERSIONS | KEY_SHARE => TlsError::Choice,
        _ => TlsError::Extension,
    }
}

/// Reads a `ServerHello` of the host with that name: the server's share of the key.
pub(crate) fn read(body: &[u8], name: Name<'_>) -> Result<[u8; POINT], TlsError> {
    let mut r = Reader::new(body);
    let version = r.u16()?;
    let random: [u8; 32] = r.array()?;
    let session = r.short()?;
    let suite = r.u16()?;
    let compression = r.u8()?;
    if version != LEGACY_VERSION {
        return Err(TlsError::Version);
    }
    let mut extensions = if r.is_empty() {
        // As an old server may end it.
        return Err(TlsError::Version);
    } else {
        r.long()?
    };
    r.end()?;
    let (mut chosen, mut share, mut other) = (None, None, None);
    while !extensions.is_empty() {
        let kind = extensions.u16()?;
        let mut content = extensions.long()?;
        let twice = match kind {
            SUPPORTED_VERSIONS => chosen.replace(content.u16()?).is_some(),
            // What a retry has here is shorter.
            KEY_SHARE if random == RETRY => return Err(TlsError::Choice),
            KEY_SHARE => {
                if content.u16()? != SECP256R1 {
                    return Err(TlsError::Choice);
                }
                let point = content.long()?.rest();
                let point = point.try_into().map_err(|_| TlsError::Choice)?;
                share.replace(point).is_some()
            }
            // An older version has others, and no version among them.
            _ => {
                other = other.or(Some(misplaced(kind, name)));
                continue;
            }
        };
        content.end()?;
        if twice {
            return Err(TlsError::Malformed);
        }
    }
    // A downgrade, by whomever: the number alone decides.
    if chosen != Some(VERSION) {
        return Err(TlsError::Version);
    }
    if let Some(error) = other {
        return Err(error);
    }
    if suite != CHACHA20_POLY1305_SHA256 || compression != 0 || !session.is_empty() {
        return Err(TlsError::Choice);
    }
    // The one group is offered with its key: there is nothing to retry with.
    if random == RETRY {
        return Err(TlsError::Choice);
    }
    share.ok_or(TlsError::Choice)
}

/// Reads `EncryptedExtensions` of the host with that name: the limit that the server sets to content and
/// type of our records.
pub(crate) fn read_encrypted(body: &[u8], name: Name<'_>) -> Result<Option<u16>, TlsError> {
    let mut r = Reader::new(body);
    let mut extensions = r.long()?;
    r.end()?;
    let mut limit = None;
    let mut seen = 0_u64;
    while !extensions.is_empty() {
        let kind = extensions.u16()?;
        let mut content = extensions.long()?;
        match kind {
            SERVER_NAME if matches!(name, Name::Host(_)) => {}
            // For a later time.
            SUPPORTED_GROUPS => content = Reader::new(&[]),
            MAX_FRAGMENT_LENGTH => {
                if content.u8()? != FRAGMENT_CODE {
                    return Err(TlsError::Choice);
                }
            }
            RECORD_SIZE_LIMIT => {
                limit = Some(content.u16()?);
                if limit < Some(LEAST_LIMIT) {
                    return Err(TlsError::Choice);
                }
            }
            _ => return Err(misplaced(kind, name)),
        }
        content.end()?;
        // Those above are below 64.
        let bit = 1 << (kind & 63);
        if seen & bit != 0 {
            return Err(TlsError::Malformed);
        }
        seen |= bit;
    }
    Ok(limit)
}
