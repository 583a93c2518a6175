//! Whether an image is the one that was signed.

use core::fmt;

use sha2::{Digest as _, Sha256};

use crate::manifest::{BLOCK_HASH, HASH, Manifest};

/// SHA-256.
#[must_use]
pub fn image_hash(bytes: &[u8]) -> [u8; HASH] {
    finish(Sha256::new_with_prefix(bytes))
}

/// Out of line: there are several hashers, and each would get a copy.
#[inline(never)]
fn finish(hash: Sha256) -> [u8; HASH] {
    hash.finalize().into()
}

/// The hash of a block: the first half of its SHA-256.
#[must_use]
pub fn block_hash(block: &[u8]) -> [u8; BLOCK_HASH] {
    half(image_hash(block))
}

fn half(hash: [u8; HASH]) -> [u8; BLOCK_HASH] {
    let mut half = [0; BLOCK_HASH];
    half.copy_from_slice(&hash[..BLOCK_HASH]);
    half
}

/// Why an image is not the one that was signed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImageError {
    /// It has more bytes than the manifest says, or the block does.
    TooLong,
    /// It ended before the manifest says it does, or the block did.
    TooShort,
    /// The block of this index is not the one that was signed.
    BadBlock(u16),
    /// Its SHA-256 is not the one that was signed, though each block is.
    BadHash,
}

impl ImageError {
    /// A stable name, for messages and records.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::TooLong => "image_too_long",
            Self::TooShort => "image_too_short",
            Self::BadBlock(_) => "bad_block",
            Self::BadHash => "bad_hash",
        }
    }
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => f.write_str("the image is longer than its manifest says"),
            Self::TooShort => f.write_str("the image is shorter than its manifest says"),
            Self::BadBlock(index) => write!(f, "block {index} is not the one that was signed"),
            Self::BadHash => f.write_str("the image is not the one that was signed"),
        }
    }
}

impl core::error::Error for ImageError {}

/// The hash of one block as its bytes arrive, so that a transfer can go on at any block; or of the whole image, as if
/// it were one.
///
/// A call takes as long as the slice it is given is: about 105 instructions a byte on RISC-V.
#[derive(Debug, Clone)]
pub struct BlockHasher {
    /// `None` of the whole image.
    index: Option<u16>,
    left: u32,
    /// Of a block the first half counts.
    expected: [u8; HASH],
    hash: Sha256,
}

impl BlockHasher {
    /// A hasher for the block of this index; `None` past the last.
    #[must_use]
    pub fn new(manifest: &Manifest<'_>, index: usize) -> Option<Self> {
        let mut expected = [0; HASH];
        expected[..BLOCK_HASH].copy_from_slice(manifest.block(index)?);
        Some(Self {
            index: Some(u16::try_from(index).ok()?),
            left: manifest.block_length(index)?,
            expected,
            hash: Sha256::new(),
        })
    }

    /// A hasher for the whole image.
    #[must_use]
    pub fn whole(manifest: &Manifest<'_>) -> Self {
        Self {
            index: None,
            left: manifest.size,
            expected: *manifest.sha256,
            hash: Sha256::new(),
        }
    }

    /// Bytes that are still to come.
    #[must_use]
    pub const fn left(&self) -> u32 {
        self.left
    }

    /// Takes the next bytes of the block.
    ///
    /// # Errors
    /// [`ImageError::TooLong`] when those are more than are left of it, which are then not taken.
    pub fn update(&mut self, bytes: &[u8]) -> Result<(), ImageError> {
        let length = u32::try_from(bytes.len()).map_err(|_| ImageError::TooLong)?;
        self.left = self.left.checked_sub(length).ok_or(ImageError::TooLong)?;
        self.hash.update(bytes);
        Ok(())
    }

    /// Whether the block, or the whole, is the one that was signed.
    ///
    /// # Errors
    /// [`ImageError::TooShort`] when bytes are missing; [`ImageError::BadBlock`] when they are others, of the whole
    /// [`ImageError::BadHash`].
    pub fn finish(self) -> Result<(), ImageError> {
        if self.left > 0 {
            return Err(ImageError::TooShort);
        }
        let counts = if self.index.is_some() {
            BLOCK_HASH
        } else {
            HASH
        };
        if finish(self.hash)[..counts] == self.expected[..counts] {
            Ok(())
        } else {
            Err(self.index.map_or(ImageError::BadHash, ImageError::BadBlock))
        }
    }
}

/// The hash of an image as its bytes are read: of each block as it is complete, of the whole at the end.
///
/// A call takes as long as the slice it is given is: twice what [`BlockHasher`] takes.
#[derive(Debug, Clone)]
pub struct ImageHasher<'a> {
    manifest: Manifest<'a>,
    /// The block that is not complete; `None` after the last.
    block: Option<BlockHasher>,
    verified: usize,
    hash: Sha256,
}

impl<'a> ImageHasher<'a> {
    /// A hasher at the beginning of an image.
    #[must_use]
    pub fn new(manifest: &Manifest<'a>) -> Self {
        Self {
            manifest: *manifest,
            block: BlockHasher::new(manifest, 0),
            verified: 0,
            hash: Sha256::new(),
        }
    }

    /// How many blocks are complete and verified.
    #[must_use]
    pub const fn verified(&self) -> usize {
        self.verified
    }

    /// Takes the next bytes of the image, across any number of blocks.
    ///
    /// # Errors
    /// [`ImageError::BadBlock`] at the first block that is not what was signed, [`ImageError::TooLong`] for
    /// bytes behind the last. After an error the hasher is of no more use.
    pub fn update(&mut self, mut bytes: &[u8]) -> Result<(), ImageError> {
        self.hash.update(bytes);
        while !bytes.is_empty() {
            let block = self.block.as_mut().ok_or(ImageError::TooLong)?;
            let count = bytes.len().min(block.left() as usize);
            let (now, later) = bytes.split_at(count);
            block.update(now)?;
            bytes = later;
            if block.left() == 0 {
                let complete = self.block.take();
                complete.map_or(Ok(()), BlockHasher::finish)?;
                self.verified += 1;
                self.block = BlockHasher::new(&self.manifest, self.verified);
            }
        }
        Ok(())
    }

    /// Whether the image is the one that was signed.
    ///
    /// # Errors
    /// [`ImageError::TooShort`] when bytes are missing, [`ImageError::BadHash`] when the whole is another.
    pub fn finish(self) -> Result<(), ImageError> {
        if self.block.is_some() {
            return Err(ImageError::TooShort);
        }
        if finish(self.hash) == *self.manifest.sha256 {
            Ok(())
        } else {
            Err(ImageError::BadHash)
        }
    }
}
