//! The bytes of a bundle: header, filling and digest.

use crate::{Bundle, BundleFault, DIGEST_BYTES, Header};

/// FNV-1a over words of eight bytes, the last one filled up with zeros: tells whether a bundle in flash is
/// whole. It holds nobody off who changes bytes on purpose; signatures do.
#[derive(Debug, Clone)]
pub struct Digest {
    hash: u64,
    /// Bytes that are no whole word yet.
    word: [u8; 8],
    length: usize,
}

impl Default for Digest {
    fn default() -> Self {
        Self::new()
    }
}

impl Digest {
    /// Of nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            hash: 0xCBF2_9CE4_8422_2325,
            word: [0; 8],
            length: 0,
        }
    }

    /// Takes the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        let missing = (8 - self.length) % 8;
        let (first, rest) = bytes.split_at(missing.min(bytes.len()));
        self.word[self.length..][..first.len()].copy_from_slice(first);
        self.length += first.len();
        if self.length == 8 {
            self.fold(self.word);
        }
        let (words, left) = rest.as_chunks::<8>();
        for word in words {
            self.fold(*word);
        }
        if !left.is_empty() {
            self.word = [0; 8];
            self.word[..left.len()].copy_from_slice(left);
            self.length = left.len();
        }
    }

    fn fold(&mut self, word: [u8; 8]) {
        self.hash = (self.hash ^ u64::from_le_bytes(word)).wrapping_mul(0x0000_0100_0000_01B3);
        (self.word, self.length) = ([0; 8], 0);
    }

    /// What it comes to.
    #[must_use]
    pub fn finish(mut self) -> [u8; DIGEST_BYTES] {
        if self.length > 0 {
            self.fold(self.word);
        }
        self.hash.to_le_bytes()
    }
}

impl Bundle {
    /// The image, of so many bytes. What fills it is drawn from `seed`, so that images of one seed differ no
    /// more than programs of neighbouring builds do.
    ///
    /// # Errors
    /// [`BundleFault::Malformed`] names what cannot be so.
    pub fn image(&self, size: u32, seed: u64) -> Result<Vec<u8>, BundleFault> {
        let header = Header {
            bundle: self.clone(),
            size,
        };
        let mut image = header.encode()?;
        let end = size as usize - DIGEST_BYTES;
        // Filled from the same place on, whatever the header says.
        let filling = (0..).flat_map(|word| mixed(seed, word).to_le_bytes());
        let skipped = image.len();
        image.extend(filling.skip(skipped).take(end.saturating_sub(skipped)));
        let mut digest = Digest::new();
        digest.update(&image);
        image.extend(digest.finish());
        Ok(image)
    }
}

/// Reads a whole image.
///
/// # Errors
/// [`BundleFault`] names what is wrong.
pub fn decode(image: &[u8]) -> Result<Bundle, BundleFault> {
    let Header { bundle, size } = Header::decode(image)?;
    let size = size as usize;
    if image.len() < size {
        return Err(BundleFault::Short);
    }
    if image.len() > size {
        return Err(BundleFault::Long);
    }
    let (before, digest) = image
        .split_last_chunk::<DIGEST_BYTES>()
        .ok_or(BundleFault::Short)?;
    let mut found = Digest::new();
    found.update(before);
    if found.finish() != *digest {
        return Err(BundleFault::Checksum);
    }
    Ok(bundle)
}

/// Word `index` of the bytes of `seed`: `SplitMix64` (Steele, Lea and Flood, 2014).
fn mixed(seed: u64, index: u64) -> u64 {
    let mut z = seed.wrapping_add((index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
