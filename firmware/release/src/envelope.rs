//! A manifest with its signature.

use crate::encoding::Malformed;
use crate::image::image_hash;
use crate::keys::{KeyId, PublicKey, SIGNATURE};
use crate::manifest::{HASH, MANIFEST_MAX, Manifest};
use crate::refusal::Refusal;

/// Most bytes of an envelope: it travels in the payload of one chunk.
pub const ENVELOPE_MAX: usize = 1_024;

/// How an envelope begins; the last byte is the version of its format.
const MAGIC: [u8; 4] = *b"TCR\x01";

/// Bytes before the manifest.
const HEAD: usize = MAGIC.len() + 8 + SIGNATURE;

const _: () = assert!(HEAD + MANIFEST_MAX <= ENVELOPE_MAX);

/// A manifest with its signature, taken apart and not yet believed.
///
/// | offset | bytes | what |
/// |---|---|---|
/// | 0 | 4 | `TCR` and the version of this format, 1 |
/// | 4 | 8 | id of the key |
/// | 12 | 64 | signature over the manifest: ECDSA with P-256 and SHA-256, r and s |
/// | 76 | at most 900 | the manifest |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signed<'a> {
    key: KeyId,
    signature: &'a [u8; SIGNATURE],
    manifest: &'a [u8],
}

impl<'a> Signed<'a> {
    /// Takes an envelope apart. Says nothing on what is in it, nor on who signed it.
    ///
    /// # Errors
    /// When it is too long, too short, or begins otherwise.
    pub fn parse(envelope: &'a [u8]) -> Result<Self, Malformed> {
        if envelope.len() > HEAD + MANIFEST_MAX {
            return Err(Malformed::Oversize);
        }
        let rest = match envelope.split_first_chunk() {
            Some((magic, rest)) if *magic == MAGIC => rest,
            _ => return Err(Malformed::Envelope),
        };
        let (key, rest) = rest.split_first_chunk().ok_or(Malformed::Envelope)?;
        let (signature, manifest) = rest.split_first_chunk().ok_or(Malformed::Envelope)?;
        let key = KeyId(*key);
        Ok(Self {
            key,
            signature,
            manifest,
        })
    }

    /// An envelope of parts: what [`Signed::write`] writes.
    ///
    /// # Errors
    /// When there is too much of a manifest.
    pub const fn new(
        key: KeyId,
        signature: &'a [u8; SIGNATURE],
        manifest: &'a [u8],
    ) -> Result<Self, Malformed> {
        if manifest.len() > MANIFEST_MAX {
            return Err(Malformed::Oversize);
        }
        Ok(Self {
            key,
            signature,
            manifest,
        })
    }

    /// Writes the envelope to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`Malformed::Oversize`] when `buf` is too short.
    pub fn write(&self, buf: &mut [u8]) -> Result<usize, Malformed> {
        let parts: [&[u8]; 4] = [&MAGIC, &self.key.0, self.signature, self.manifest];
        let mut at = 0;
        for part in parts {
            let end = at + part.len();
            let place = buf.get_mut(at..end).ok_or(Malformed::Oversize)?;
            place.copy_from_slice(part);
            at = end;
        }
        Ok(at)
    }

    /// The key that it says it is signed with.
    #[must_use]
    pub const fn key(&self) -> KeyId {
        self.key
    }

    /// SHA-256 of the manifest's bytes: what is signed.
    #[must_use]
    pub fn hash(&self) -> [u8; HASH] {
        image_hash(self.manifest)
    }

    /// Names the release: the first eight bytes of the [`Self::hash`]. It depends on the manifest alone, so signing
    /// it with another key does not change it. Chunks carry its first four bytes, as a little-endian number.
    #[must_use]
    pub fn id(&self) -> [u8; 8] {
        let mut id = [0; 8];
        id.copy_from_slice(&self.hash()[..8]);
        id
    }

    /// The manifest of somebody, to be shown and not to be acted on: anybody can have written it.
    ///
    /// # Errors
    /// [`Malformed`] names what is wrong with it.
    pub fn unverified(&self) -> Result<Manifest<'a>, Malformed> {
        Manifest::decode(self.manifest)
    }

    /// The manifest, if the holder of `key` signed it. Its bytes are not looked at before that is certain.
    ///
    /// # Errors
    /// [`Refusal::UnknownKey`], [`Refusal::BadSignature`], or [`Refusal::Malformed`] for what was signed and
    /// is no manifest.
    pub fn authenticate(&self, key: &PublicKey) -> Result<Manifest<'a>, Refusal> {
        if key.id() != self.key {
            return Err(Refusal::UnknownKey(self.key));
        }
        if !key.signed(&self.hash(), self.signature) {
            return Err(Refusal::BadSignature);
        }
        Ok(Manifest::decode(self.manifest)?)
    }
}
