//! The format of a blob, version 1.
//!
//! Everything is little-endian and may lie at any address. Offsets count from the beginning.
//!
//! | at | type | header |
//! |---:|---|---|
//! | 0 | `[u8; 4]` | `TCMM` |
//! | 4 | u16 | version, 1 |
//! | 6 | u16 | number of layers, 1 to [`MAX_LAYERS`] |
//! | 8 | u32 | length of the blob |
//! | 12 | u32 | CRC-32 (ISO-HDLC) of all that follows |
//! | 16 | u16 × 3 | height, width, channels of the input |
//! | 22 | i8 | zero point of the input |
//! | 23 | i8 | binary exponent of a step of the output: a logit is `q · 2^exponent` |
//! | 24 | u32 | offset of the labels |
//! | 28 | u16 | number of labels: 0, or one for each channel of the output |
//! | 30 | u16 | 0 |
//!
//! Layers follow, 32 bytes each. Tensor 0 is the input, tensor *n* the output of the *n*th layer;
//! the last one is the output of the model.
//!
//! | at | type | layer |
//! |---:|---|---|
//! | 0 | u8 | 1 convolution, 2 depthwise convolution, 3 sum |
//! | 1 | u8 | kernel: height and width, 1 to [`MAX_KERNEL`] |
//! | 2 | u8 | stride, 1 to [`MAX_STRIDE`] |
//! | 3, 4 | u8 | rows (columns) of padding above (left) and below (right), each less than the kernel |
//! | 5 | i8 | zero point of the output |
//! | 6, 7 | i8 | lowest and highest output: this is where rectifiers are |
//! | 8 | u16 | tensor it looks at |
//! | 10 | u16 | second tensor, of a sum |
//! | 12 | u16 | channels of the output |
//! | 14 | u8 × 3 | of a sum: `sa`, `sb`, `s` |
//! | 17 | `[u8; 3]` | 0 |
//! | 20 | u32 | offset of the weights, i8 |
//! | 24 | u32 | offset of `bias'`, i32 for each output channel |
//! | 28 | u32 | offset of the multipliers `m`, then the shifts `s`, u8 for each output channel |
//!
//! Weights of a depthwise convolution are `[ky][kx][channel]`. Those of others come in groups of
//! eight output channels, the last one filled up with zeros. A group goes through the taps, which
//! are `[ky][kx][in]`, and has for each of them the weights of its eight channels.
//!
//! A label is a byte with its length, and so many bytes of text.

/// What every blob begins with.
pub const MAGIC: [u8; 4] = *b"TCMM";
/// The version that this crate reads and writes.
pub const VERSION: u16 = 1;
/// Most layers of a model.
pub const MAX_LAYERS: usize = 48;
/// Most rows, columns or channels of a tensor.
pub const MAX_EXTENT: u16 = 512;
/// Largest kernel.
pub const MAX_KERNEL: u8 = 7;
/// Largest stride.
pub const MAX_STRIDE: u8 = 4;
/// Most weights of one output channel of a convolution that is larger than one pixel.
pub const MAX_PATCH: usize = 512;
/// Largest shift of a requantisation or of a sum.
pub const MAX_SHIFT: u8 = 24;
/// Largest shift of a summand.
pub const MAX_LIFT: u8 = 12;

pub(crate) const HEADER: usize = 32;
pub(crate) const LAYER: usize = 32;

/// CRC-32 (ISO-HDLC), four bits at a time: 64 bytes of table.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 16] = {
        let mut table = [0; 16];
        let mut n = 0;
        while n < 16 {
            let mut value = n as u32;
            let mut bit = 0;
            while bit < 4 {
                value = if value & 1 == 1 {
                    (value >> 1) ^ 0xEDB8_8320
                } else {
                    value >> 1
                };
                bit += 1;
            }
            table[n] = value;
            n += 1;
        }
        table
    };
    let mut crc = u32::MAX;
    for &byte in bytes {
        crc = (crc >> 4) ^ TABLE[((crc ^ u32::from(byte)) & 15) as usize];
        crc = (crc >> 4) ^ TABLE[((crc ^ u32::from(byte >> 4)) & 15) as usize];
    }
    !crc
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_checksum_is_the_usual_one() {
        // The check value of CRC-32/ISO-HDLC.
        assert_eq!(super::checksum(b"123456789"), 0xCBF4_3926);
    }
}
