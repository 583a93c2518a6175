//! The compression: heatshrink, of which a decoder needs its window and a few bits.

use crate::{DeltaError, LEAST_LENGTH_BITS, LEAST_WINDOW_BITS, WINDOW, WINDOW_BITS};

/// Reads a stream of heatshrink from pieces of any length.
#[derive(Debug, Clone)]
pub(crate) struct Heatshrink {
    /// The last bytes that came out, the newest before `next`. Larger than some streams ask for, which makes
    /// no difference to them.
    window: [u8; WINDOW],
    next: u16,
    /// How far back the copy under way begins, and how many of its bytes are still to come.
    distance: u16,
    left: u16,
    /// Bits that were read and not used, the first one highest; below them zeros.
    bits: u32,
    held: u8,
    window_bits: u8,
    length_bits: u8,
}

impl Heatshrink {
    pub(crate) const fn new() -> Self {
        Self {
            window: [0; WINDOW],
            next: 0,
            distance: 0,
            left: 0,
            bits: 0,
            held: 0,
            window_bits: LEAST_WINDOW_BITS,
            length_bits: LEAST_LENGTH_BITS,
        }
    }

    /// Takes the parameters of the stream as detools writes them.
    ///
    /// # Errors
    /// [`DeltaError::Window`] when they are too large, or none of heatshrink.
    pub(crate) fn configure(&mut self, parameters: u8) -> Result<(), DeltaError> {
        let window_bits = (parameters >> 4) + LEAST_WINDOW_BITS;
        let length_bits = (parameters & 0x0F) + LEAST_LENGTH_BITS;
        if window_bits > WINDOW_BITS || length_bits >= window_bits {
            return Err(DeltaError::Window);
        }
        self.window_bits = window_bits;
        self.length_bits = length_bits;
        Ok(())
    }

    /// Fills `out` as far as the input goes, and takes what it needs off the front of `input`. Returns how many
    /// bytes there are; fewer than `out` has room for only when `input` is used up.
    pub(crate) fn read(&mut self, input: &mut &[u8], out: &mut [u8]) -> usize {
        let mut length = 0;
        for byte in out {
            let value = if self.left > 0 {
                self.left -= 1;
                self.before(self.distance)
            } else {
                match self.symbol(input) {
                    Some(value) => value,
                    None => break,
                }
            };
            self.window[usize::from(self.next) % WINDOW] = value;
            self.next = self.next.wrapping_add(1);
            *byte = value;
            length += 1;
        }
        length
    }

    /// Reads a symbol and returns its first byte; `None` when not all of it is there.
    fn symbol(&mut self, input: &mut &[u8]) -> Option<u8> {
        while self.held <= 24 {
            let Some((byte, rest)) = input.split_first() else {
                break;
            };
            self.bits |= u32::from(*byte) << (24 - self.held);
            self.held += 8;
            *input = rest;
        }
        if self.bits >> 31 == 1 {
            let value = (self.bits << 1 >> 24) as u8;
            return self.drop(9).then_some(value);
        }
        let distance = (self.bits << 1 >> (32 - self.window_bits)) as u16 + 1;
        let length = (self.bits << (1 + self.window_bits) >> (32 - self.length_bits)) as u16 + 1;
        if !self.drop(1 + self.window_bits + self.length_bits) {
            return None;
        }
        self.distance = distance;
        self.left = length - 1;
        Some(self.before(distance))
    }

    /// Drops that many bits; leaves them all when there are fewer.
    const fn drop(&mut self, count: u8) -> bool {
        if self.held < count {
            return false;
        }
        self.bits <<= count;
        self.held -= count;
        true
    }

    /// The byte that came out so long ago.
    fn before(&self, distance: u16) -> u8 {
        self.window[usize::from(self.next.wrapping_sub(distance)) % WINDOW]
    }

    /// Whether more than the bits that fill up the last byte is left of what was read.
    pub(crate) const fn has_more(&self) -> bool {
        self.left > 0 || self.held >= 8
    }
}

// A symbol fits the bits that are held, and a whole number of windows the numbers that go around.
const _: () = assert!(2 * WINDOW_BITS as u32 <= 25 && 65_536 % WINDOW == 0);

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// Bits, as text, in bytes.
    fn stream(bits: &str) -> Vec<u8> {
        let bits: Vec<u8> = bits.bytes().filter(|bit| *bit != b' ').collect();
        let byte = |bits: &[u8]| {
            (0..8).fold(0, |byte, at| {
                byte << 1 | u8::from(bits.get(at) == Some(&b'1'))
            })
        };
        bits.chunks(8).map(byte).collect()
    }

    fn decode(parameters: u8, input: &[u8], piece: usize, buffer: usize) -> Vec<u8> {
        let mut heatshrink = Heatshrink::new();
        heatshrink.configure(parameters).expect("parameters");
        let (mut out, mut buf) = (Vec::new(), std::vec![0; buffer]);
        for mut input in input.chunks(piece) {
            loop {
                let length = heatshrink.read(&mut input, &mut buf);
                out.extend_from_slice(&buf[..length]);
                if length < buffer {
                    assert!(input.is_empty());
                    break;
                }
            }
        }
        out
    }

    #[test]
    fn bytes_and_copies() {
        // With four bits of window and three of length: `ab`, six bytes from two back, two from three before
        // the beginning, the last of a full window.
        let input = stream("1 01100001  1 01100010  0 0001 101  0 1010 001  0 1001 000");
        for piece in 1..=input.len() {
            for buffer in [1, 2, 3, 100] {
                let out = decode(0x00, &input, piece, buffer);
                assert_eq!(out, b"abababab\0\0a", "{piece} {buffer}");
            }
        }
    }

    #[test]
    fn a_copy_reaches_as_far_as_the_window() {
        // 1,024 zeros are before the first byte; then one byte and 1,023 copies of its like.
        let far = stream(
            "1 01111000  0 0000000000 111111111  0 0000000000 111111110  0 1111111111 000000000",
        );
        let mut heatshrink = Heatshrink::new();
        heatshrink.configure(0x66).expect("the largest");
        let (mut input, mut out) = (&far[..], [0; 1_025]);
        assert_eq!(heatshrink.read(&mut input, &mut out), 1_025);
        assert_eq!(out, [b'x'; 1_025]);
        assert!(input.is_empty() && !heatshrink.has_more());
    }

    #[test]
    fn parameters_have_limits() {
        for parameters in 0..=u8::MAX {
            let (window, length) = ((parameters >> 4) + 4, (parameters & 0x0F) + 3);
            let fits = window <= 10 && length < window;
            let came = Heatshrink::new().configure(parameters);
            assert_eq!(
                came,
                if fits {
                    Ok(())
                } else {
                    Err(DeltaError::Window)
                }
            );
        }
    }
}
