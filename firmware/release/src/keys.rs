//! The public keys that releases are signed with.

use core::fmt;

use p256::ecdsa::signature::hazmat::PrehashVerifier as _;
use p256::ecdsa::{Signature, VerifyingKey};

use crate::image::image_hash;

/// Bytes of a public key: a point of P-256, uncompressed (SEC 1, section 2.3.3).
pub const POINT: usize = 65;

/// Bytes of a signature: r and s, 32 bytes each, big-endian (IEEE P1363).
pub const SIGNATURE: usize = 64;

/// Which key a release is signed with: the first eight bytes of the SHA-256 of its [`POINT`] bytes.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct KeyId(pub [u8; 8]);

impl fmt::Display for KeyId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for KeyId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Bytes that are no point of P-256.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeyError;

impl fmt::Display for KeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a public key of P-256")
    }
}

impl core::error::Error for KeyError {}

/// A public key, with its id.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublicKey {
    id: KeyId,
    key: VerifyingKey,
}

impl PublicKey {
    /// A key in the form of SEC 1, compressed or not.
    ///
    /// # Errors
    /// When that is no point of P-256.
    pub fn from_sec1(bytes: &[u8]) -> Result<Self, KeyError> {
        let key = VerifyingKey::from_sec1_bytes(bytes).map_err(|_| KeyError)?;
        let point = key.to_sec1_point(false);
        let mut id = KeyId([0; 8]);
        id.0.copy_from_slice(&image_hash(point.as_bytes())[..8]);
        Ok(Self { id, key })
    }

    /// Its id.
    #[must_use]
    pub const fn id(&self) -> KeyId {
        self.id
    }

    /// Whether `signature` was made over a message with this SHA-256 by the holder of this key.
    #[must_use]
    pub fn signed(&self, hash: &[u8; 32], signature: &[u8; SIGNATURE]) -> bool {
        Signature::from_slice(signature)
            .is_ok_and(|signature| self.key.verify_prehash(hash, &signature).is_ok())
    }
}

/// The keys that a robot believes. Both are compiled into its program and are no setting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublicKeys {
    /// The key that releases are signed with.
    pub current: PublicKey,
    /// The key that they will be signed with once the other is lost, or given up.
    pub next: Option<PublicKey>,
}

impl PublicKeys {
    /// The key of this id.
    #[must_use]
    pub fn find(&self, id: KeyId) -> Option<&PublicKey> {
        [Some(&self.current), self.next.as_ref()]
            .into_iter()
            .flatten()
            .find(|key| key.id == id)
    }
}
