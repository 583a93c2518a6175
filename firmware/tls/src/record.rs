//! Records (RFC 8446, section 5).

use chacha20poly1305::aead::AeadInOut;
use chacha20poly1305::{ChaCha20Poly1305, KeyInit};

use crate::error::TlsError;
use crate::keys::{HASH, Secret, expand};

/// Bytes before the content.
pub(crate) const HEADER: usize = 5;
/// Bytes of the tag behind it.
pub(crate) const TAG: usize = 16;
/// Bytes by which an encrypted record is longer than its content.
pub(crate) const OVERHEAD: usize = HEADER + 1 + TAG;

pub(crate) const CHANGE_CIPHER_SPEC: u8 = 20;
pub(crate) const ALERT: u8 = 21;
pub(crate) const HANDSHAKE: u8 = 22;
pub(crate) const DATA: u8 = 23;

/// The keys of one direction.
pub(crate) struct Keys {
    secret: Secret,
    key: Secret,
    iv: [u8; 12],
    sequence: u64,
}

impl Keys {
    pub(crate) fn new(secret: Secret) -> Result<Self, TlsError> {
        let mut keys = Self {
            secret,
            key: Secret::default(),
            iv: [0; 12],
            sequence: 0,
        };
        keys.derive()?;
        Ok(keys)
    }

    /// With this very key, which no secret stands behind.
    #[cfg(test)]
    pub(crate) fn with_key(key: Secret) -> Self {
        Self {
            secret: Secret::default(),
            key,
            iv: [0; 12],
            sequence: 0,
        }
    }

    fn derive(&mut self) -> Result<(), TlsError> {
        expand(&self.secret, "key", &[], &mut *self.key)?;
        expand(&self.secret, "iv", &[], &mut self.iv)?;
        self.sequence = 0;
        Ok(())
    }

    /// Goes on to the next generation of keys (section 7.2).
    pub(crate) fn update(&mut self) -> Result<(), TlsError> {
        let mut next = [0; HASH];
        expand(&self.secret, "traffic upd", &[], &mut next)?;
        *self.secret = next;
        self.derive()
    }

    /// The number of the next record, as a nonce.
    fn nonce(&mut self) -> Result<[u8; 12], TlsError> {
        let mut nonce = self.iv;
        for (byte, count) in nonce.iter_mut().skip(4).zip(self.sequence.to_be_bytes()) {
            *byte ^= count;
        }
        // Whoever gets there has been connected for longer than there are robots.
        self.sequence = self.sequence.checked_add(1).ok_or(TlsError::Flood)?;
        Ok(nonce)
    }

    fn cipher(&self) -> ChaCha20Poly1305 {
        ChaCha20Poly1305::new((&*self.key).into())
    }

    /// Encrypts `inner` where it is; the tag.
    pub(crate) fn encrypt(
        &self,
        nonce: [u8; 12],
        header: &[u8],
        inner: &mut [u8],
    ) -> Result<[u8; TAG], TlsError> {
        self.cipher()
            .encrypt_inout_detached(&nonce.into(), header, inner.into())
            .map(Into::into)
            .map_err(|_| TlsError::Unusable)
    }

    /// Decrypts `inner` where it is.
    pub(crate) fn decrypt(
        &self,
        nonce: [u8; 12],
        header: &[u8],
        inner: &mut [u8],
        tag: [u8; TAG],
    ) -> Result<(), TlsError> {
        self.cipher()
            .decrypt_inout_detached(&nonce.into(), header, inner.into(), &tag.into())
            .map_err(|_| TlsError::BadRecord)
    }

    /// Writes a record with this content to the front of `out`; its length.
    pub(crate) fn seal(
        &mut self,
        kind: u8,
        content: &[u8],
        out: &mut [u8],
    ) -> Result<usize, TlsError> {
        let total = content.len() + OVERHEAD;
        let record = out.get_mut(..total).ok_or(TlsError::Unusable)?;
        let (header, body) = record.split_at_mut(HEADER);
        header.copy_from_slice(&head(DATA, total - HEADER));
        let (inner, tag) = body
            .split_at_mut_checked(content.len() + 1)
            .ok_or(TlsError::Unusable)?;
        for (to, from) in inner.iter_mut().zip(content.iter().chain([&kind])) {
            *to = *from;
        }
        let nonce = self.nonce()?;
        tag.copy_from_slice(&self.encrypt(nonce, header, inner)?);
        Ok(total)
    }

    /// Decrypts the body of a record where it is; its type, and the length of the content, which is
    /// at the front of `body` then.
    pub(crate) fn open(
        &mut self,
        header: [u8; HEADER],
        body: &mut [u8],
    ) -> Result<(u8, usize), TlsError> {
        let inner = body.len().checked_sub(TAG).ok_or(TlsError::BadRecord)?;
        let (inner, tag) = body
            .split_at_mut_checked(inner)
            .ok_or(TlsError::BadRecord)?;
        let tag: [u8; TAG] = (&*tag).try_into().map_err(|_| TlsError::BadRecord)?;
        let nonce = self.nonce()?;
        self.decrypt(nonce, &header, inner, tag)?;
        // Zeros behind the type are there to hide the length.
        let end = inner.iter().rposition(|byte| *byte != 0);
        let end = end.ok_or(TlsError::Unexpected)?;
        let kind = inner.get(end).ok_or(TlsError::Unexpected)?;
        Ok((*kind, end))
    }
}

/// What stands before a record.
pub(crate) const fn head(kind: u8, length: usize) -> [u8; HEADER] {
    let [high, low] = (length as u16).to_be_bytes();
    [kind, 3, 3, high, low]
}
