//! The pieces in which a release travels.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 1 | format, 1 |
//! | 1 | 1 | part: 0 manifest (the whole envelope), 1 image, 2 delta |
//! | 2 | 2 | length of the payload, 1 to 1,024 |
//! | 4 | 4 | tag of the release: the first four bytes of its id |
//! | 8 | 4 | index of the chunk within its part |
//! | 12 | 4 | CRC-32 (ISO-HDLC) of the first twelve bytes and the payload |
//! | 16 | | payload |
//!
//! Numbers are little-endian. The checksum finds what went wrong on the way; what somebody did on purpose is
//! found by the hashes of the manifest.

use core::fmt;

use crate::envelope::ENVELOPE_MAX;

/// Bytes before the payload.
pub const HEADER: usize = 16;

/// Most bytes of payload. Every chunk of a part but its last has as many.
pub const PAYLOAD: usize = 1_024;

/// Most bytes of a chunk.
pub const CHUNK_MAX: usize = HEADER + PAYLOAD;

/// Version of the format of chunks.
const FORMAT: u8 = 1;

const _: () = assert!(ENVELOPE_MAX <= PAYLOAD);

/// What a chunk is a piece of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Part {
    /// The envelope, which is one chunk.
    Manifest,
    /// The image.
    Image,
    /// The patch that makes the image out of another.
    Delta,
}

impl Part {
    /// Every part, in the order of their numbers in a chunk.
    pub const ALL: [Self; 3] = [Self::Manifest, Self::Image, Self::Delta];

    /// Its name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Manifest => "manifest",
            Self::Image => "image",
            Self::Delta => "delta",
        }
    }
}

/// Why bytes are no chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ChunkError {
    /// Fewer bytes than a chunk has at least, or than this one says.
    Short,
    /// More bytes than this one says.
    Long,
    /// A format of a later version.
    Format,
    /// An unknown part.
    Part,
    /// A payload of no bytes, or of more than [`PAYLOAD`].
    Length,
    /// Changed on the way.
    Checksum,
}

impl ChunkError {
    /// A stable name, for messages and records.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::Short => "chunk_short",
            Self::Long => "chunk_long",
            Self::Format => "chunk_format",
            Self::Part => "chunk_part",
            Self::Length => "chunk_length",
            Self::Checksum => "chunk_checksum",
        }
    }
}

impl fmt::Display for ChunkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Short => "the chunk is cut off",
            Self::Long => "bytes behind the chunk",
            Self::Format => "a chunk of another format",
            Self::Part => "a chunk of an unknown part",
            Self::Length => "a chunk of no or too many bytes",
            Self::Checksum => "the chunk was changed on its way",
        })
    }
}

impl core::error::Error for ChunkError {}

/// A piece of a release.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk<'a> {
    /// What it is a piece of.
    pub part: Part,
    /// The transfer that it belongs to.
    pub tag: u32,
    /// Which piece: its first byte is byte `index` × [`PAYLOAD`] of its part.
    pub index: u32,
    /// 1 to [`PAYLOAD`] bytes.
    pub payload: &'a [u8],
}

impl<'a> Chunk<'a> {
    /// Writes the chunk to the front of `buf` and returns its length, at most [`CHUNK_MAX`].
    ///
    /// # Errors
    /// [`ChunkError::Length`] for a payload that no chunk can have, [`ChunkError::Short`] when `buf` is.
    pub fn encode(&self, buf: &mut [u8]) -> Result<usize, ChunkError> {
        let length = self.payload.len();
        if !(1..=PAYLOAD).contains(&length) {
            return Err(ChunkError::Length);
        }
        let chunk = buf.get_mut(..HEADER + length).ok_or(ChunkError::Short)?;
        let (header, payload) = chunk.split_at_mut(HEADER);
        payload.copy_from_slice(self.payload);
        header[0] = FORMAT;
        header[1] = self.part as u8;
        header[2..4].copy_from_slice(&(length as u16).to_le_bytes());
        header[4..8].copy_from_slice(&self.tag.to_le_bytes());
        header[8..12].copy_from_slice(&self.index.to_le_bytes());
        let checksum = checksum(&[&header[..12], self.payload]);
        header[12..].copy_from_slice(&checksum.to_le_bytes());
        Ok(HEADER + length)
    }

    /// Reads a chunk from the whole of `bytes`.
    ///
    /// # Errors
    /// [`ChunkError`] names what is wrong. What is accepted is what [`Chunk::encode`] writes, to the bit.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, ChunkError> {
        let (header, payload) = bytes
            .split_first_chunk::<HEADER>()
            .ok_or(ChunkError::Short)?;
        let [
            format,
            part,
            l0,
            l1,
            t0,
            t1,
            t2,
            t3,
            i0,
            i1,
            i2,
            i3,
            c0,
            c1,
            c2,
            c3,
        ] = *header;
        if format != FORMAT {
            return Err(ChunkError::Format);
        }
        let part = *Part::ALL.get(usize::from(part)).ok_or(ChunkError::Part)?;
        let length = usize::from(u16::from_le_bytes([l0, l1]));
        if !(1..=PAYLOAD).contains(&length) {
            return Err(ChunkError::Length);
        }
        if payload.len() < length {
            return Err(ChunkError::Short);
        }
        if payload.len() > length {
            return Err(ChunkError::Long);
        }
        if checksum(&[&header[..12], payload]) != u32::from_le_bytes([c0, c1, c2, c3]) {
            return Err(ChunkError::Checksum);
        }
        Ok(Self {
            part,
            tag: u32::from_le_bytes([t0, t1, t2, t3]),
            index: u32::from_le_bytes([i0, i1, i2, i3]),
            payload,
        })
    }
}

/// How many chunks a part of `size` bytes has.
#[must_use]
pub const fn count(size: u32) -> u32 {
    size.div_ceil(PAYLOAD as u32)
}

/// Bytes of the payload of chunk `index` in a part of `size` bytes; `None` past the last.
#[must_use]
pub const fn length(size: u32, index: u32) -> Option<usize> {
    if index >= count(size) {
        return None;
    }
    // Not past the end, so no overflow.
    let left = (size - index * PAYLOAD as u32) as usize;
    Some(if left < PAYLOAD { left } else { PAYLOAD })
}

/// CRC-32 (ISO-HDLC), four bits at a time: 64 bytes of table.
fn checksum(parts: &[&[u8]]) -> u32 {
    const TABLE: [u32; 16] = {
        let mut table = [0; 16];
        let mut n = 0;
        while n < 16 {
            let mut value = n as u32;
            let mut bit = 0;
            while bit < 4 {
                value = (value >> 1) ^ (0xEDB8_8320 * (value & 1));
                bit += 1;
            }
            table[n] = value;
            n += 1;
        }
        table
    };
    let mut crc = u32::MAX;
    for &byte in parts.iter().copied().flatten() {
        crc = (crc >> 4) ^ TABLE[((crc ^ u32::from(byte)) & 15) as usize];
        crc = (crc >> 4) ^ TABLE[((crc ^ u32::from(byte >> 4)) & 15) as usize];
    }
    !crc
}

#[cfg(test)]
mod tests {
    use super::checksum;

    #[test]
    fn the_checksum_is_the_usual_one() {
        // The check value of CRC-32/ISO-HDLC.
        assert_eq!(checksum(&[b"1234", b"", b"56789"]), 0xCBF4_3926);
    }
}
