//! Deltas: patches that make the image of a release out of that of an earlier one.
//!
//! [`make`] finds what two images have in common with the algorithm of bsdiff and writes it down as [`crawler_delta`] reads it,
//! which is the format of detools: `detools apply_patch OLD PATCH NEW` makes the new image as well.
//! [`between`] does so for two files with releases. A patch is signed by nobody; what a robot makes with it
//! is held against the manifest of the release, which is.
//!
//! # Reading order
//!
//! `records`, what is to be compressed; `heatshrink`, the compression; `releases`, both ends as files.

mod heatshrink;
mod records;
mod releases;

use crawler_delta::{Decoder, DeltaError, LEAST_LENGTH_BITS, Step, WINDOW_BITS, add};

pub use releases::{Between, BetweenFault, Side, between};

/// Most bytes of an image that a patch is made of or for: the largest image of a release.
pub const IMAGE_MAX: usize = crawler_release::MAX_IMAGE as usize;

/// Type and compression of a patch: sequential, heatshrink.
const TYPE: u8 = 0x04;

/// Makes a patch from `old` to `new`, the smallest that a decoder with the window of robots can read. The same
/// images give the same patch. Takes half a second for images of 600 KB, and ten times as much memory as
/// both.
///
/// # Panics
/// When one of them is longer than [`IMAGE_MAX`].
#[must_use]
pub fn make(old: &[u8], new: &[u8]) -> Vec<u8> {
    assert!(old.len().max(new.len()) <= IMAGE_MAX, "an image too long");
    let mut patch = vec![TYPE];
    records::push_number(&mut patch, new.len() as i64);
    if new.is_empty() {
        return patch;
    }
    let records = records::between(old, new);
    let matches = heatshrink::matches(&records, WINDOW_BITS);
    let compressed = (LEAST_LENGTH_BITS..WINDOW_BITS)
        .map(|length_bits| heatshrink::compress(&records, &matches, WINDOW_BITS, length_bits))
        .min_by_key(Vec::len);
    patch.extend(compressed.unwrap_or_default());
    patch
}

/// Applies a patch as a robot does: what it makes of `old` is `new` bytes long.
///
/// # Errors
/// [`DeltaError`] when it is no patch between images of these lengths.
pub fn apply(old: &[u8], new: u32, patch: &[u8]) -> Result<Vec<u8>, DeltaError> {
    let length = u32::try_from(old.len()).map_err(|_| DeltaError::Outside)?;
    let mut decoder = Decoder::new(length, new);
    let (mut rest, mut made, mut out) = (patch, Vec::new(), [0; 4_096]);
    while let Step::Made { length, old: from } = decoder.step(&mut rest, &mut out)? {
        let out = &mut out[..length];
        if let Some(from) = from {
            add(out, &old[from as usize..]);
        }
        made.extend_from_slice(out);
    }
    decoder.finish().map(|()| made)
}
