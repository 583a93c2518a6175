//! Reads an application image back, as the bootloader will.
//!
//! Source: ESP-IDF Programming Guide, "App Image Format"; esptool documentation, "Firmware Image
//! Format".

use sha2::{Digest as _, Sha256};

const MAGIC: u8 = 0xe9;
const HEADER: usize = 24;
const SEGMENT_HEADER: usize = 8;
const CHECKSUM_SEED: u8 = 0xef;
const HASH: usize = 32;
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

/// Checks structure, checksum and hash.
///
/// # Errors
/// Says what the bootloader would stumble over.
pub(crate) fn read(image: &[u8]) -> Result<AppImage, String> {
    let header = image.get(..HEADER).ok_or("shorter than its header")?;
    if header[0] != MAGIC {
        return Err(format!("magic {:#04x} instead of {MAGIC:#04x}", header[0]));
    }
    let segments = header[1];
    if segments == 0 || segments > MOST_SEGMENTS {
        return Err(format!(
            "{segments} segments; 1 to {MOST_SEGMENTS} can be loaded"
        ));
    }
    let mut at = HEADER;
    let mut payload = 0;
    let mut checksum = CHECKSUM_SEED;
    for number in 1..=segments {
        let short = || format!("ends inside segment {number} of {segments}");
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
        return Err("wrong checksum".to_owned());
    }
    if header[23] != 1 {
        return Err("no hash behind it".to_owned());
    }
    let hash = image.get(end..end + HASH).ok_or("ends inside its hash")?;
    if hash != Sha256::digest(&image[..end]).as_slice() {
        return Err("wrong hash".to_owned());
    }
    if image.len() != end + HASH {
        return Err(format!("{} bytes too many", image.len() - end - HASH));
    }
    Ok(AppImage {
        chip: u16::from_le_bytes([header[12], header[13]]),
        entry: word(header, 4).ok_or("no entry")?,
        segments,
        payload,
    })
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?))
}
