//! Running fingerprints of states and histories.

use rand_core::Rng;
use rand_pcg::Pcg32;

/// FNV-1a (Fowler, Noll, Vo), 64 bits, over words of eight bytes, each folded by `FOLD` bits once
/// more, because FNV moves nothing downwards: fixed for ever, unlike the hasher of `std`, and fast
/// enough to take in every message of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fnv<const FOLD: u32>(u64);

/// Of a history: messages, moments, and the states on the way.
pub type Fingerprint = Fnv<29>;

/// Of a state. Histories are compared across builds, so it keeps the fold that it always had.
pub(crate) type StateFingerprint = Fnv<32>;

impl<const FOLD: u32> Fnv<FOLD> {
    /// Of nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    /// Takes in one word.
    pub const fn word(&mut self, word: u64) {
        let mixed = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01B3);
        self.0 = mixed ^ (mixed >> FOLD);
    }

    /// Takes in bytes and their number.
    pub fn bytes(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        for word in words {
            self.word(u64::from_le_bytes(*word));
        }
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.word(u64::from_le_bytes(last));
        self.word(bytes.len() as u64);
    }

    /// Takes in the bits of a number.
    pub(crate) const fn float(&mut self, value: f32) {
        self.word(value.to_bits() as u64);
    }

    /// Takes in where a generator stands, told by what it would give next.
    pub(crate) fn generator(&mut self, rng: &Pcg32) {
        self.word(rng.clone().next_u64());
    }

    /// The fingerprint so far.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }
}

impl<const FOLD: u32> Default for Fnv<FOLD> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(parts: &[&[u8]]) -> u64 {
        let mut print = Fingerprint::new();
        for part in parts {
            print.bytes(part);
        }
        print.value()
    }

    #[test]
    fn what_differs_anywhere_has_another_fingerprint() {
        let all = [
            of(&[]),
            of(&[b""]),
            of(&[b"\0"]),
            of(&[b"\0\0"]),
            of(&[b"ab"]),
            of(&[b"ba"]),
            of(&[b"a", b"b"]),
            of(&[b"12345678"]),
            of(&[b"12345678\0"]),
            of(&[b"1234567812345678"]),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(all[i + 1..].iter().all(|b| a != b));
        }
    }

    #[test]
    fn the_algorithm_does_not_change() {
        assert_eq!(of(&[b"terracrawler"]), EXPECTED);
    }

    /// Histories are compared across builds, so this is part of what a fingerprint means.
    const EXPECTED: u64 = 0x6992_B8A4_085D_6E7F;
}
