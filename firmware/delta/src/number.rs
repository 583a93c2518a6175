//! The numbers of a patch, byte by byte.

use crate::DeltaError;

/// A number that is being read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Number {
    value: u32,
    /// Bits that are there already.
    bits: u8,
    negative: bool,
}

impl Number {
    pub(crate) const fn new() -> Self {
        Self {
            value: 0,
            bits: 0,
            negative: false,
        }
    }

    /// Takes the next byte. The number, from −(2^31 − 1) to 2^31 − 1, once that is its last; the next byte then
    /// begins another.
    ///
    /// # Errors
    /// [`DeltaError::Number`] for a number beyond, which also ends one that goes on and on.
    pub(crate) fn push(&mut self, byte: u8) -> Result<Option<i32>, DeltaError> {
        if self.bits == 0 {
            self.negative = byte & 0x40 != 0;
            self.value = u32::from(byte & 0x3F);
            self.bits = 6;
        } else {
            let more = u32::from(byte & 0x7F);
            // 6, 13, 20 or 27: of the fifth byte, four bits have room.
            if self.bits > 27 || (self.bits == 27 && more > 0x0F) {
                return Err(DeltaError::Number);
            }
            self.value |= more << self.bits;
            self.bits += 7;
        }
        if byte & 0x80 != 0 {
            return Ok(None);
        }
        let value = self.value as i32;
        let value = if self.negative { -value } else { value };
        *self = Self::new();
        Ok(Some(value))
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// As detools writes it (`pack_size` in `bsdiff.c`).
    fn pack(value: i64) -> Vec<u8> {
        let mut rest = value.unsigned_abs();
        let mut bytes = Vec::from([(rest & 0x3F) as u8 | if value < 0 { 0x40 } else { 0 }]);
        rest >>= 6;
        while rest > 0 {
            *bytes.last_mut().expect("a byte") |= 0x80;
            bytes.push((rest & 0x7F) as u8);
            rest >>= 7;
        }
        bytes
    }

    fn read(bytes: &[u8]) -> Result<Option<i32>, DeltaError> {
        let mut number = Number::new();
        let (last, first) = bytes.split_last().expect("bytes");
        for byte in first {
            assert_eq!(number.push(*byte)?, None);
        }
        let value = number.push(*last)?;
        assert_eq!(number == Number::new(), value.is_some());
        Ok(value)
    }

    #[test]
    fn numbers_are_those_of_detools() {
        let ends = (0..31).flat_map(|bits| [(1_i64 << bits) - 1, 1 << bits, (1 << bits) + 1]);
        for value in ends.chain([i64::from(i32::MAX)]) {
            for value in [value, -value] {
                assert_eq!(read(&pack(value)), Ok(Some(value as i32)), "{value}");
            }
        }
        // Zero with a sign, and with bytes that add nothing.
        assert_eq!(read(&[0x40]), Ok(Some(0)));
        assert_eq!(read(&[0xC1, 0x80, 0x00]), Ok(Some(-1)));
    }

    #[test]
    fn a_number_has_an_end() {
        for value in [1_i64 << 31, -(1 << 31), 1 << 40, i64::MAX] {
            assert_eq!(read(&pack(value)), Err(DeltaError::Number), "{value}");
        }
        assert_eq!(read(&[0xFF; 4]), Ok(None));
        assert_eq!(read(&[0x80; 6]), Err(DeltaError::Number));
        assert_eq!(read(&[0xFF; 6]), Err(DeltaError::Number));
    }
}
