//! Keys in files: PKCS#8 (RFC 5958) and `SubjectPublicKeyInfo` (RFC 5480), in PEM.

use std::fmt;

use crawler_release::{KeyError, PublicKey};
use p256::ecdsa::signature::hazmat::PrehashSigner as _;
use p256::ecdsa::{Signature, SigningKey};
use p256::elliptic_curve::sec1::ToSec1Point as _;
use p256::pkcs8::{DecodePrivateKey as _, DecodePublicKey as _};
use p256::pkcs8::{EncodePrivateKey as _, EncodePublicKey as _, LineEnding};

/// Why a text holds no key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum KeyFault {
    /// It is none of P-256 in PKCS#8.
    NotPrivate,
    /// It is a public key, where a private one is needed.
    PublicGiven,
    /// It is in the older form of OpenSSL, which tells how to change that.
    Sec1,
    /// It is encrypted.
    Encrypted,
    /// It is no public key of P-256.
    NotPublic,
    /// It is a private key, where a public one is enough.
    PrivateGiven,
    /// The machine has no random numbers.
    Random,
}

impl fmt::Display for KeyFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotPrivate => "not a private key of P-256 (PKCS#8, PEM)",
            Self::PublicGiven => "a public key; signing takes the private one",
            Self::Sec1 => {
                "a key in the older form; `openssl pkcs8 -topk8 -nocrypt -in OLD -out NEW` changes that"
            }
            Self::Encrypted => {
                "an encrypted key; `openssl pkcs8 -in KEY -out PLAIN` decrypts it"
            }
            Self::NotPublic => "not a public key of P-256 (PEM)",
            Self::PrivateGiven => "a private key; give away the public one alone",
            Self::Random => "the machine has no random numbers",
        })
    }
}

impl std::error::Error for KeyFault {}

impl From<KeyError> for KeyFault {
    fn from(_: KeyError) -> Self {
        Self::NotPublic
    }
}

/// A key that signs releases.
pub struct SecretKey(p256::SecretKey);

impl fmt::Debug for SecretKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SecretKey({})", self.public().id())
    }
}

impl SecretKey {
    /// A new one, from the random numbers of the machine.
    ///
    /// # Errors
    /// [`KeyFault::Random`] when there are none.
    pub fn generate() -> Result<Self, KeyFault> {
        loop {
            let mut bytes = [0; 32];
            getrandom::fill(&mut bytes).map_err(|_| KeyFault::Random)?;
            // One in 2^32 is no number of the curve.
            if let Ok(key) = p256::SecretKey::from_slice(&bytes) {
                return Ok(Self(key));
            }
        }
    }

    /// Reads one from the text of a file.
    ///
    /// # Errors
    /// [`KeyFault`] says what the text is instead, as far as it can be told.
    pub fn from_pem(text: &str) -> Result<Self, KeyFault> {
        p256::SecretKey::from_pkcs8_pem(text)
            .map(Self)
            .map_err(|_| {
                let has = |label: &str| text.contains(&format!("-----BEGIN {label}-----"));
                if has("PUBLIC KEY") {
                    KeyFault::PublicGiven
                } else if has("EC PRIVATE KEY") {
                    KeyFault::Sec1
                } else if has("ENCRYPTED PRIVATE KEY") {
                    KeyFault::Encrypted
                } else {
                    KeyFault::NotPrivate
                }
            })
    }

    /// Its text for a file that nobody else reads.
    ///
    /// # Panics
    /// Never: every key can be written.
    #[must_use]
    pub fn to_pem(&self) -> String {
        let text = self.0.to_pkcs8_pem(LineEnding::LF);
        text.expect("every key can be written").to_string()
    }

    /// The public half.
    ///
    /// # Panics
    /// Never: the public half of a key is a point.
    #[must_use]
    pub fn public(&self) -> PublicKey {
        let point = self.0.public_key().to_sec1_point(false);
        PublicKey::from_sec1(point.as_bytes()).expect("the public half of a key is a point")
    }

    /// The text of the public half, for a file that anybody may read.
    ///
    /// # Panics
    /// Never: every key can be written.
    #[must_use]
    pub fn public_pem(&self) -> String {
        let text = self.0.public_key().to_public_key_pem(LineEnding::LF);
        text.expect("every key can be written")
    }

    /// Signs what has this SHA-256: r and s. The same hash gives the same signature (RFC 6979).
    ///
    /// # Panics
    /// Never: a hash of 32 bytes can be signed.
    #[must_use]
    pub fn sign(&self, hash: &[u8; 32]) -> [u8; 64] {
        let signature: Signature = SigningKey::from(&self.0)
            .sign_prehash(hash)
            .expect("a hash of 32 bytes can be signed");
        signature.to_bytes().into()
    }
}

/// Reads a public key from the text of a file.
///
/// # Errors
/// [`KeyFault`] says what the text is instead.
pub fn public_from_pem(text: &str) -> Result<PublicKey, KeyFault> {
    let key = p256::PublicKey::from_public_key_pem(text).map_err(|_| {
        if text.contains("PRIVATE KEY-----") {
            KeyFault::PrivateGiven
        } else {
            KeyFault::NotPublic
        }
    })?;
    Ok(PublicKey::from_sec1(key.to_sec1_point(false).as_bytes())?)
}
