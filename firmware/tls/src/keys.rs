//! The key schedule (RFC 8446, section 7).

use hkdf::Hkdf;
use hkdf::hmac::{Hmac, KeyInit, Mac};
use sha2::{Digest, Sha256};
use zeroize::Zeroizing;

use crate::error::TlsError;

/// Bytes of a hash, and of every secret.
pub(crate) const HASH: usize = 32;

/// A secret, forgotten when it goes.
pub(crate) type Secret = Zeroizing<[u8; HASH]>;

/// `HKDF-Expand-Label`.
pub(crate) fn expand(
    secret: &[u8; HASH],
    label: &str,
    context: &[u8],
    out: &mut [u8],
) -> Result<(), TlsError> {
    let length = (out.len() as u16).to_be_bytes();
    let label_length = [6 + label.len() as u8];
    let context_length = [context.len() as u8];
    let info: [&[u8]; 6] = [
        &length,
        &label_length,
        b"tls13 ",
        label.as_bytes(),
        &context_length,
        context,
    ];
    // Does not fail: no more than one hash is asked for.
    expand_info(secret, &info, out)
}

/// `HKDF-Expand` (RFC 5869, section 2.3), which has an end at 255 hashes.
pub(crate) fn expand_info(
    secret: &[u8; HASH],
    info: &[&[u8]],
    out: &mut [u8],
) -> Result<(), TlsError> {
    Hkdf::<Sha256>::from_prk(secret)
        .map_err(|_| TlsError::Unusable)?
        .expand_multi_info(info, out)
        .map_err(|_| TlsError::Unusable)
}

/// `Derive-Secret`, with the hash of the messages.
pub(crate) fn derive(
    secret: &[u8; HASH],
    label: &str,
    hash: &[u8; HASH],
) -> Result<Secret, TlsError> {
    let mut out = Secret::default();
    expand(secret, label, hash, &mut *out)?;
    Ok(out)
}

/// `HKDF-Extract`.
pub(crate) fn extract(salt: &[u8; HASH], input: &[u8]) -> Secret {
    let (secret, _) = Hkdf::<Sha256>::extract(Some(salt), input);
    Zeroizing::new(secret.into())
}

/// The salt of the stage after that of `secret`.
fn next_salt(secret: &[u8; HASH]) -> Result<Secret, TlsError> {
    derive(secret, "derived", &Sha256::digest([]).into())
}

/// The secret of the handshake, from what the exchange of keys gave. Without a pre-shared key the
/// stage before is known to everybody.
pub(crate) fn handshake(shared: &[u8]) -> Result<Secret, TlsError> {
    let early = extract(&[0; HASH], &[0; HASH]);
    let salt = next_salt(&early)?;
    Ok(extract(&salt, shared))
}

/// The master secret.
pub(crate) fn master(handshake: &[u8; HASH]) -> Result<Secret, TlsError> {
    let salt = next_salt(handshake)?;
    Ok(extract(&salt, &[0; HASH]))
}

/// The key of a Finished message.
fn finished_mac(secret: &[u8; HASH], hash: &[u8; HASH]) -> Result<Hmac<Sha256>, TlsError> {
    let mut key = Secret::default();
    expand(secret, "finished", &[], &mut *key)?;
    let mut mac = Hmac::<Sha256>::new_from_slice(&*key).map_err(|_| TlsError::Unusable)?;
    mac.update(hash);
    Ok(mac)
}

/// What a Finished message holds.
pub(crate) fn finished(secret: &[u8; HASH], hash: &[u8; HASH]) -> Result<[u8; HASH], TlsError> {
    Ok(finished_mac(secret, hash)?.finalize().into_bytes().into())
}

/// Checks what a Finished message holds, in the same time whatever is wrong.
pub(crate) fn check_finished(
    secret: &[u8; HASH],
    hash: &[u8; HASH],
    data: &[u8],
) -> Result<(), TlsError> {
    finished_mac(secret, hash)?
        .verify_slice(data)
        .map_err(|_| TlsError::Finished)
}
