//! From the certificate of the server to the authority.

use crate::certificate::Certificate;
use crate::error::TlsError;
use crate::expected::Expected;
use crate::name::Name;
use crate::reader::Reader;
use crate::sizes::POINT;

/// Most certificates between that of the server and the authority.
pub const MOST_BETWEEN: u8 = 2;

/// 2026-11-01, in seconds since 1970: before this program was made. What had ended by then is
/// refused also by a robot that does not know the time.
pub const MADE_AFTER: u64 = 1_793_491_200;

/// Checks the list of a Certificate message (RFC 8446, section 4.4.2); the key of the server.
pub(crate) fn check(list: &[u8], expected: &Expected<'_>) -> Result<[u8; POINT], TlsError> {
    let name = Name::new(expected.host)?;
    let mut list = Reader::new(list);
    // RFC 8446, section 4.4.2.4: an empty list is no message.
    let server = next(&mut list)?.ok_or(TlsError::Malformed)?;
    let key = *server.key()?;
    server.check_server()?;
    check_time(&server, expected.now)?;
    let names = server.names.ok_or(TlsError::Name)?;
    if !name.is_among(names)? {
        return Err(TlsError::Name);
    }
    let mut current = server;
    let mut between = 0;
    // Each certificate directly certifies the one before it; the authority's own may be left out.
    while let Some(above) = next(&mut list)? {
        if above.subject != current.issuer {
            break;
        }
        let above_key = above.key()?;
        if expected.authority.is(above_key) {
            break;
        }
        if between == MOST_BETWEEN {
            return Err(TlsError::LongChain);
        }
        above.check_authority(between)?;
        check_time(&above, expected.now)?;
        current.check_signature(above_key)?;
        between += 1;
        current = above;
    }
    current.check_signature(expected.authority.as_bytes())?;
    Ok(key)
}

fn next<'a>(list: &mut Reader<'a>) -> Result<Option<Certificate<'a>>, TlsError> {
    if list.is_empty() {
        return Ok(None);
    }
    let length = list.u24()?;
    let certificate = list.take(length)?;
    // None was asked for.
    if !list.long()?.is_empty() {
        return Err(TlsError::Extension);
    }
    Certificate::parse(certificate).map(Some)
}

fn check_time(certificate: &Certificate<'_>, now: Option<u64>) -> Result<(), TlsError> {
    if certificate.until < now.unwrap_or(MADE_AFTER) {
        return Err(TlsError::Expired);
    }
    if now.is_some_and(|now| now < certificate.from) {
        return Err(TlsError::NotYet);
    }
    Ok(())
}
