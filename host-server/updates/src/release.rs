//! Releases as files: made, signed and verified without a server.
//!
//! A release is carried as one file:
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 2 | length of the envelope, little-endian |
//! | 2 | at most 976 | the envelope: the signed manifest, see [`crawler_release::Signed`] |
//! | behind it | as the manifest says | the image |
//!
//! [`SecretKey`] and [`PublicKey`](crawler_release::PublicKey) come from PEM files that OpenSSL reads as well.
//! [`SignOptions`] says what is to be signed, [`inspect`] what a file is worth.

mod image;
mod inspect;
mod keys;
mod sign;

use std::fmt;

use crawler_release::{ENVELOPE_MAX, MAX_IMAGE};

pub use image::{BOARDS, ImageFault, chip_for, chip_of};
pub use inspect::{Expected, Fault, Inspection, inspect};
pub use keys::{KeyFault, SecretKey, public_from_pem};
pub use sign::{SignFault, SignOptions};

/// Most bytes of a file with a release.
pub const FILE_MAX: usize = 2 + ENVELOPE_MAX + MAX_IMAGE as usize;

/// Bytes that are no file with a release.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileFault;

impl fmt::Display for FileFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a release: it does not begin with a signed manifest, or is cut off")
    }
}

impl std::error::Error for FileFault {}

/// Puts a release into one file.
///
/// # Errors
/// When the envelope is longer than one can be.
pub fn join(envelope: &[u8], image: &[u8]) -> Result<Vec<u8>, FileFault> {
    let length = u16::try_from(envelope.len()).map_err(|_| FileFault)?;
    if envelope.len() > ENVELOPE_MAX {
        return Err(FileFault);
    }
    Ok([&length.to_le_bytes(), envelope, image].concat())
}

/// Takes a file with a release apart: its envelope and its image. Neither is believed yet.
///
/// # Errors
/// When it is shorter than it says, or its envelope is longer than one can be.
pub fn split(file: &[u8]) -> Result<(&[u8], &[u8]), FileFault> {
    let (length, rest) = file.split_first_chunk().ok_or(FileFault)?;
    let length = usize::from(u16::from_le_bytes(*length));
    if length > ENVELOPE_MAX {
        return Err(FileFault);
    }
    rest.split_at_checked(length).ok_or(FileFault)
}
