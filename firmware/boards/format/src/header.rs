//! What stands before a program in a slot of the emulated board.
//!
//! | bytes | what |
//! |---|---|
//! | 0..4 | `TCVI` |
//! | 4..8 | format, 1 |
//! | 8..12 | length of the program in bytes |
//! | 12..16 | where it runs |
//! | 16..32 | zeros |
//! | 32..64 | SHA-256 over the 32 bytes before and the program |
//!
//! As with the images of an ESP32, what starts a program needs nothing but the image to know that it is whole; who
//! made it is a question that the robot program asks before it lets an update be started.

use sha2::{Digest as _, Sha256};

use crate::layout::{PROGRAM, PROGRAM_MAX};

const MAGIC: [u8; 4] = *b"TCVI";
const FORMAT: u32 = 1;
/// Bytes that the hash covers, and those before it.
const HASHED: usize = 32;

/// Digits of a build id.
pub const BUILD: usize = 16;

/// The header of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    length: u32,
    hash: [u8; 32],
}

impl Header {
    /// Bytes of a header.
    pub const BYTES: usize = 64;

    /// The header of `program`; `None` when it is empty, or longer than [`PROGRAM_MAX`].
    #[must_use]
    pub fn of(program: &[u8]) -> Option<Self> {
        let length = u32::try_from(program.len()).ok()?;
        if length == 0 || length > PROGRAM_MAX {
            return None;
        }
        Some(Self {
            length,
            hash: hash(length, program),
        })
    }

    /// The header in these bytes; `None` when there is none, or that of a program that cannot run here.
    #[must_use]
    pub fn parse(bytes: &[u8; Self::BYTES]) -> Option<Self> {
        let (head, rest) = bytes.split_first_chunk::<HASHED>()?;
        let length = u32::from_le_bytes(*head.get(8..)?.first_chunk()?);
        if *head != fields(length) || length == 0 || length > PROGRAM_MAX {
            return None;
        }
        Some(Self {
            length,
            hash: *rest.first_chunk()?,
        })
    }

    /// Its bytes.
    #[must_use]
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let (head, hash) = bytes.split_at_mut(HASHED);
        head.copy_from_slice(&fields(self.length));
        hash.copy_from_slice(&self.hash);
        bytes
    }

    /// Bytes of the program.
    #[must_use]
    pub const fn length(&self) -> u32 {
        self.length
    }

    /// Whether `program` is the one that this header was made for, to the bit.
    #[must_use]
    pub fn matches(&self, program: &[u8]) -> bool {
        program.len() == self.length as usize && hash(self.length, program) == self.hash
    }

    /// The build id of the program: the first digits of its hash, so no two programs share one.
    #[must_use]
    pub fn build(&self) -> [u8; BUILD] {
        let mut digits = [0; BUILD];
        for (pair, byte) in digits.chunks_exact_mut(2).zip(self.hash) {
            for (digit, nibble) in pair.iter_mut().zip([byte >> 4, byte & 15]) {
                *digit = b"0123456789abcdef"[usize::from(nibble)];
            }
        }
        digits
    }
}

fn fields(length: u32) -> [u8; HASHED] {
    let mut bytes = [0; HASHED];
    let (words, _) = bytes.as_chunks_mut::<4>();
    let values = [u32::from_le_bytes(MAGIC), FORMAT, length, PROGRAM];
    for (word, value) in words.iter_mut().zip(values) {
        *word = value.to_le_bytes();
    }
    bytes
}

fn hash(length: u32, program: &[u8]) -> [u8; 32] {
    let mut hasher = Sha256::new();
    hasher.update(fields(length));
    hasher.update(program);
    hasher.finalize().into()
}

#[cfg(test)]
mod tests {
    use std::vec;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn sizes_are_bounded() {
        assert_eq!(Header::of(&[]), None);
        let largest = vec![0; PROGRAM_MAX as usize];
        assert!(Header::of(&largest).is_some());
        assert_eq!(Header::of(&[largest, vec![0]].concat()), None);
    }

    #[test]
    fn a_build_id_is_hexadecimal() {
        let header = Header {
            length: 1,
            hash: core::array::from_fn(|at| (at * 17) as u8),
        };
        assert_eq!(&header.build(), b"0011223344556677");
    }

    proptest! {
        #[test]
        fn one_flipped_bit_is_another_image(program in prop::collection::vec(any::<u8>(), 1..200), bit in 0_usize..2_000) {
            let header = Header::of(&program).expect("short");
            let mut image = [&header.to_bytes()[..], &program].concat();
            let whole = |image: &[u8]| {
                let (head, program) = image.split_first_chunk().expect("longer");
                Header::parse(head).is_some_and(|header| header.matches(program))
            };
            prop_assert!(whole(&image));
            let bit = bit % (image.len() * 8);
            image[bit / 8] ^= 1 << (bit % 8);
            prop_assert!(!whole(&image));
        }

        #[test]
        fn whatever_the_bytes_are_a_header_is_one_or_none(bytes in any::<[u8; 32]>(), rest in any::<[u8; 32]>()) {
            let mut all = [0; Header::BYTES];
            all[..32].copy_from_slice(&bytes);
            all[32..].copy_from_slice(&rest);
            if let Some(header) = Header::parse(&all) {
                prop_assert_eq!(header.to_bytes(), all);
            }
        }
    }
}
