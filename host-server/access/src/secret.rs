//! Random secrets of machines, and what is kept of them.

use core::fmt;
use core::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest as _, Sha256};
use subtle::ConstantTimeEq as _;

/// Characters of a secret as text: 32 bytes in base64url without padding.
const TEXT: usize = 43;

/// 32 random bytes: the password of a robot, a refresh token, an invitation, a key.
///
/// Its text is base64url. [`Debug`](fmt::Debug) hides it, [`Display`](fmt::Display) does not: it is
/// shown once, to whom it belongs, and only its [`Digest`] is kept.
#[derive(Clone)]
pub struct Secret([u8; 32]);

/// The system has no random numbers to give.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoRandomness;

/// A text is not a secret: 43 characters of base64url.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SecretError;

/// SHA-256 of a [`Secret`]. A secret has 256 random bits, so a fast hash keeps it safe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest(pub [u8; 32]);

impl Secret {
    /// A new one.
    ///
    /// # Errors
    /// [`NoRandomness`] when the system gives none.
    pub fn generate() -> Result<Self, NoRandomness> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes).map_err(|_| NoRandomness)?;
        Ok(Self(bytes))
    }

    /// What is kept of it.
    #[must_use]
    pub fn digest(&self) -> Digest {
        Digest(Sha256::digest(self.0).into())
    }

    /// Its bytes, for whoever keeps a key.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl Digest {
    /// Whether it is the digest of `secret`. Takes the same time either way.
    #[must_use]
    pub fn matches(&self, secret: &Secret) -> bool {
        self.0.ct_eq(&secret.digest().0).into()
    }
}

impl From<[u8; 32]> for Secret {
    fn from(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(hidden)")
    }
}

impl fmt::Display for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&URL_SAFE_NO_PAD.encode(self.0))
    }
}

impl FromStr for Secret {
    type Err = SecretError;

    /// Each secret has one spelling only.
    fn from_str(text: &str) -> Result<Self, SecretError> {
        decode(text).map(Self).ok_or(SecretError)
    }
}

/// 32 bytes of base64url, in their one spelling.
pub(crate) fn decode(text: &str) -> Option<[u8; 32]> {
    if text.len() != TEXT {
        return None;
    }
    // Padding and bits left over are refused by this engine.
    URL_SAFE_NO_PAD.decode(text).ok()?.try_into().ok()
}

impl fmt::Display for NoRandomness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the system gives no random numbers")
    }
}

impl core::error::Error for NoRandomness {}

impl fmt::Display for SecretError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a secret: 43 characters of base64url")
    }
}

impl core::error::Error for SecretError {}
