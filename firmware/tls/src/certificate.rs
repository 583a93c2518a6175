//! X.509 certificates (RFC 5280), version 3 with ECDSA.

use p256::ecdsa::signature::hazmat::PrehashVerifier;
use p256::ecdsa::{Signature, VerifyingKey};
use sha2::{Digest, Sha256};

use crate::der::{
    BIT_STRING, BOOLEAN, Der, INTEGER, OCTET_STRING, OID, SEQUENCE, scalar, whole_bits,
};
use crate::error::TlsError;
use crate::sizes::POINT;
use crate::time;

const WRONG: TlsError = TlsError::BadCertificate;

/// `ecdsa-with-SHA256` (RFC 5758, section 3.2), the content of its `AlgorithmIdentifier`.
const ECDSA_SHA256: &[u8] = &[6, 8, 0x2A, 0x86, 0x48, 0xCE, 0x3D, 4, 3, 2];
/// `id-ecPublicKey` with `secp256r1` (RFC 5480, section 2.1.1).
const P256: &[u8] = &[
    6, 7, 0x2A, 0x86, 0x48, 0xCE, 0x3D, 2, 1, //
    6, 8, 0x2A, 0x86, 0x48, 0xCE, 0x3D, 3, 1, 7,
];

/// Extensions (section 4.2.1), by the last arc of their identifiers.
const KEY_USAGE: [u8; 3] = [0x55, 0x1D, 15];
const ALTERNATIVE_NAMES: [u8; 3] = [0x55, 0x1D, 17];
const BASIC_CONSTRAINTS: [u8; 3] = [0x55, 0x1D, 19];
const EXTENDED_KEY_USAGE: [u8; 3] = [0x55, 0x1D, 37];
/// `id-kp-serverAuth` and `anyExtendedKeyUsage`.
const SERVER_AUTH: &[u8] = &[0x2B, 6, 1, 5, 5, 7, 3, 1];
const ANY_USAGE: &[u8] = &[0x55, 0x1D, 37, 0];

/// Bits of the first byte of a key usage.
const DIGITAL_SIGNATURE: u8 = 0x80;
const KEY_CERT_SIGN: u8 = 0x04;

/// What a certificate says.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Certificate<'a> {
    signed: &'a [u8],
    algorithm: &'a [u8],
    signature: &'a [u8],
    pub(crate) issuer: &'a [u8],
    pub(crate) subject: &'a [u8],
    pub(crate) from: u64,
    pub(crate) until: u64,
    key_algorithm: &'a [u8],
    key: &'a [u8],
    authority: Option<Constraints>,
    key_usage: Option<u8>,
    /// Whether servers may show it, where it says what it is for.
    server_auth: Option<bool>,
    pub(crate) names: Option<&'a [u8]>,
}

/// Basic constraints.
#[derive(Debug, Clone, Copy)]
struct Constraints {
    authority: bool,
    path: Option<u8>,
}

impl<'a> Certificate<'a> {
    pub(crate) fn parse(der: &'a [u8]) -> Result<Self, TlsError> {
        let mut outer = Der(der);
        let mut all = outer.sequence()?;
        outer.end()?;
        let signed = all.next()?;
        let algorithm = all.expect(SEQUENCE)?;
        let signature = whole_bits(all.expect(BIT_STRING)?)?;
        all.end()?;
        if signed.tag != SEQUENCE {
            return Err(WRONG);
        }
        let mut tbs = Der(signed.content);
        // Version 3: the others have no extensions.
        if tbs.optional(0xA0)? != Some(&[INTEGER, 1, 2]) {
            return Err(WRONG);
        }
        let _serial = tbs.expect(INTEGER)?;
        if tbs.expect(SEQUENCE)? != algorithm {
            return Err(WRONG);
        }
        let issuer = tbs.expect(SEQUENCE)?;
        let mut validity = tbs.sequence()?;
        let (from, until) = (time::read(&mut validity)?, time::read(&mut validity)?);
        validity.end()?;
        let subject = tbs.expect(SEQUENCE)?;
        let (key_algorithm, key) = key_info(&mut tbs)?;
        // Unique identifiers, which nobody writes any more.
        let _ = (tbs.optional(0x81)?, tbs.optional(0x82)?);
        let mut certificate = Self {
            signed: signed.whole,
            algorithm,
            signature,
            issuer,
            subject,
            from,
            until,
            key_algorithm,
            key,
            authority: None,
            key_usage: None,
            server_auth: None,
            names: None,
        };
        if let Some(extensions) = tbs.optional(0xA3)? {
            let mut wrapped = Der(extensions);
            let mut extensions = wrapped.sequence()?;
            wrapped.end()?;
            while !extensions.is_empty() {
                certificate.extension(extensions.sequence()?)?;
            }
        }
        tbs.end()?;
        Ok(certificate)
    }

    fn extension(&mut self, mut extension: Der<'a>) -> Result<(), TlsError> {
        let id = extension.expect(OID)?;
        let critical = match extension.optional(BOOLEAN)? {
            None => false,
            Some([0xFF]) => true,
            // The default is not written in DER.
            Some(_) => return Err(WRONG),
        };
        let value = extension.expect(OCTET_STRING)?;
        extension.end()?;
        let twice = match <[u8; 3]>::try_from(id) {
            Ok(KEY_USAGE) => {
                let mut bits = Der(value);
                // How many bits are unused, and at least one byte of them.
                let [0..=7, first, ..] = *bits.expect(BIT_STRING)? else {
                    return Err(WRONG);
                };
                bits.end()?;
                self.key_usage.replace(first).is_some()
            }
            Ok(ALTERNATIVE_NAMES) => self.names.replace(value).is_some(),
            Ok(BASIC_CONSTRAINTS) => self.authority.replace(constraints(value)?).is_some(),
            Ok(EXTENDED_KEY_USAGE) => self.server_auth.replace(is_for_servers(value)?).is_some(),
            _ if critical => return Err(TlsError::Purpose),
            _ => false,
        };
        if twice { Err(WRONG) } else { Ok(()) }
    }

    /// The key, an uncompressed point.
    pub(crate) fn key(&self) -> Result<&'a [u8; POINT], TlsError> {
        point((self.key_algorithm, self.key))
    }

    /// Whether a server may show it.
    pub(crate) fn check_server(&self) -> Result<(), TlsError> {
        let signs = self
            .key_usage
            .is_none_or(|bits| bits & DIGITAL_SIGNATURE != 0);
        if signs && self.server_auth != Some(false) {
            Ok(())
        } else {
            Err(TlsError::Purpose)
        }
    }

    /// Whether it may sign others that have `below` authorities between them and the server.
    pub(crate) fn check_authority(&self, below: u8) -> Result<(), TlsError> {
        let authority = self
            .authority
            .is_some_and(|own| own.authority && own.path.is_none_or(|path| below <= path));
        let signs = self.key_usage.is_none_or(|bits| bits & KEY_CERT_SIGN != 0);
        if authority && signs && self.server_auth != Some(false) {
            Ok(())
        } else {
            Err(TlsError::Purpose)
        }
    }

    /// Whether the holder of `key` has signed it.
    pub(crate) fn check_signature(&self, key: &[u8]) -> Result<(), TlsError> {
        if self.algorithm != ECDSA_SHA256 {
            return Err(TlsError::Algorithm);
        }
        let genuine = verify(key, &[self.signed], self.signature).map_err(|_| WRONG)?;
        if genuine {
            Ok(())
        } else {
            Err(TlsError::Untrusted)
        }
    }
}

/// Reads a `SubjectPublicKeyInfo` (section 4.1): algorithm and key.
pub(crate) fn key_info<'a>(der: &mut Der<'a>) -> Result<(&'a [u8], &'a [u8]), TlsError> {
    let mut info = der.sequence()?;
    let algorithm = info.expect(SEQUENCE)?;
    let key = whole_bits(info.expect(BIT_STRING)?)?;
    info.end()?;
    Ok((algorithm, key))
}

/// A key of the one kind there is, as an uncompressed point. Whether it is one of the curve is found out
/// when it is used.
pub(crate) fn point<'a>((algorithm, key): (&[u8], &'a [u8])) -> Result<&'a [u8; POINT], TlsError> {
    if algorithm != P256 {
        return Err(TlsError::Algorithm);
    }
    key.try_into().map_err(|_| TlsError::Algorithm)
}

/// Whether `signature`, in DER, is that of the holder of `key` on what `parts` say.
pub(crate) fn verify(key: &[u8], parts: &[&[u8]], signature: &[u8]) -> Result<bool, TlsError> {
    let key = VerifyingKey::from_sec1_bytes(key).map_err(|_| WRONG)?;
    let mut outer = Der(signature);
    let mut pair = outer.sequence()?;
    outer.end()?;
    let (r, s) = (pair.expect(INTEGER)?, pair.expect(INTEGER)?);
    pair.end()?;
    let signature = Signature::from_scalars(scalar(r)?, scalar(s)?).map_err(|_| WRONG)?;
    let mut hash = Sha256::new();
    for part in parts {
        hash.update(part);
    }
    Ok(key.verify_prehash(&hash.finalize(), &signature).is_ok())
}

fn constraints(value: &[u8]) -> Result<Constraints, TlsError> {
    let mut outer = Der(value);
    let mut fields = outer.sequence()?;
    outer.end()?;
    let authority = match fields.optional(BOOLEAN)? {
        None => false,
        Some([0xFF]) => true,
        Some(_) => return Err(WRONG),
    };
    let path = match fields.optional(INTEGER)? {
        None => None,
        Some([path @ 0..=0x7F]) => Some(*path),
        Some(_) => return Err(WRONG),
    };
    fields.end()?;
    Ok(Constraints { authority, path })
}

fn is_for_servers(value: &[u8]) -> Result<bool, TlsError> {
    let mut outer = Der(value);
    let mut purposes = outer.sequence()?;
    outer.end()?;
    let mut found = false;
    while !purposes.is_empty() {
        let purpose = purposes.expect(OID)?;
        found |= purpose == SERVER_AUTH || purpose == ANY_USAGE;
    }
    Ok(found)
}
