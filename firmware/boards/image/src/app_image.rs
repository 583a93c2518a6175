//! Reads an application image back, as the bootloader will.
//!
//! Source: ESP-IDF Programming Guide, "App Image Format"; esptool documentation, "Firmware Image
//! Format".

use std::fmt;

use sha2::{Digest as _, Sha256};

const MAGIC: u8 = 0xe9;
const HEADER: usize = 24;
const SEGMENT_HEADER: usize = 8;
const CHECKSUM_SEED: u8 = 0xef;
const HASH: usize = 32;
/// Where the application descriptor begins, behind the headers of image and segment, how it begins, and where in it
/// the hash of the ELF file is (ESP-IDF, `esp_app_desc_t`).
const DESCRIPTOR: usize = HEADER + SEGMENT_HEADER;
const DESCRIPTOR_MAGIC: u32 = 0xABCD_5432;
const ELF_HASH: usize = DESCRIPTOR + 144;
/// Bytes of that hash that are the build id.
const BUILD: usize = 8;
/// The bootloader refuses more.
const MOST_SEGMENTS: u8 = 16;

/// What stands in an image.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct AppImage {
    /// Which chip it is for, as in the image header.
    pub(crate) chip: u16,
    /// Where it starts.
    pub(crate) entry: u32,
    /// Segments to load or map.
    pub(crate) segments: u8,
    /// Bytes of those segments.
    pub(crate) payload: usize,
}

/// What the bootloader would stumble over.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum ImageError {
    /// It ends inside its header.
    NoHeader,
    /// It begins with another byte.
    Magic(u8),
    /// As many segments as cannot be loaded.
    Segments(u8),
    /// It ends inside this segment of so many.
    InsideSegment(u8, u8),
    /// The checksum is another.
    Checksum,
    /// The header says that there is no hash.
    NoHash,
    /// It ends inside its hash.
    InsideHash,
    /// The hash is another.
    Hash,
    /// So many bytes lie behind its end.
    TooLong(usize),
    /// It does not begin with an application descriptor.
    NoDescriptor,
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoHeader => f.write_str("shorter than its header"),
            Self::Magic(magic) => write!(f, "magic {magic:#04x} instead of {MAGIC:#04x}"),
            Self::Segments(segments) => {
                write!(f, "{segments} segments; 1 to {MOST_SEGMENTS} can be loaded")
            }
            Self::InsideSegment(number, segments) => {
                write!(f, "ends inside segment {number} of {segments}")
            }
            Self::Checksum => f.write_str("wrong checksum"),
            Self::NoHash => f.write_str("no hash behind it"),
            Self::InsideHash => f.write_str("ends inside its hash"),
            Self::Hash => f.write_str("wrong hash"),
            Self::TooLong(bytes) => write!(f, "{bytes} bytes too many"),
            Self::NoDescriptor => f.write_str("no application descriptor at its start"),
        }
    }
}

/// Checks structure, checksum and hash.
///
/// # Errors
/// See [`ImageError`].
pub(crate) fn read(image: &[u8]) -> Result<AppImage, ImageError> {
    let header: &[u8; HEADER] = image.first_chunk().ok_or(ImageError::NoHeader)?;
    if header[0] != MAGIC {
        return Err(ImageError::Magic(header[0]));
    }
    let segments = header[1];
    if segments == 0 || segments > MOST_SEGMENTS {
        return Err(ImageError::Segments(segments));
    }
    let mut at = HEADER;
    let mut payload = 0;
    let mut checksum = CHECKSUM_SEED;
    for number in 1..=segments {
        let short = || ImageError::InsideSegment(number, segments);
        let length = word(image, at + 4).ok_or_else(short)? as usize;
        let from = at + SEGMENT_HEADER;
        let to = from.checked_add(length).ok_or_else(short)?;
        let data = image.get(from..to).ok_or_else(short)?;
        checksum = data.iter().fold(checksum, |sum, byte| sum ^ byte);
        payload += length;
        at = to;
    }
    // The checksum is the last byte of a row of 16.
    let end = (at / 16 + 1) * 16;
    if image.get(end - 1) != Some(&checksum) {
        return Err(ImageError::Checksum);
    }
    if header[23] != 1 {
        return Err(ImageError::NoHash);
    }
    let hash = image.get(end..end + HASH).ok_or(ImageError::InsideHash)?;
    if hash != Sha256::digest(&image[..end]).as_slice() {
        return Err(ImageError::Hash);
    }
    if image.len() != end + HASH {
        return Err(ImageError::TooLong(image.len() - end - HASH));
    }
    Ok(AppImage {
        chip: u16::from_le_bytes([header[12], header[13]]),
        entry: u32::from_le_bytes([header[4], header[5], header[6], header[7]]),
        segments,
        payload,
    })
}

/// The build id of the program in `image`: the first bytes of the hash of its ELF file, which the program reads in
/// its descriptor as well.
///
/// # Errors
/// [`ImageError::NoDescriptor`].
pub(crate) fn build(image: &[u8]) -> Result<String, ImageError> {
    if word(image, DESCRIPTOR) != Some(DESCRIPTOR_MAGIC) {
        return Err(ImageError::NoDescriptor);
    }
    let hash = image.get(ELF_HASH..).and_then(<[u8]>::first_chunk);
    let hash: &[u8; BUILD] = hash.ok_or(ImageError::NoDescriptor)?;
    Ok(format!("{:016x}", u64::from_be_bytes(*hash)))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?))
}
