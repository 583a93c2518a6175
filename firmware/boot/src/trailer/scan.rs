//! Reading a trailer piece by piece: a robot has no room for a whole sector.

use super::{ENVELOPE_AT, ENVELOPE_MAX, MAGIC, RECORDS_AT, Record, Trailer, length_word};
use crate::crc::crc32_le;
use crate::flash::{SECTOR, WORD};

/// Takes the bytes of a trailer in pieces of any length, and says what is in it.
#[derive(Debug, Clone)]
pub struct Scanner {
    position: usize,
    /// Bytes of the word that is not complete.
    word: [u8; WORD],
    magic: bool,
    /// Length of the envelope; 0 when what stands there is none.
    length: usize,
    /// CRC that the envelope should have, and that of its bytes so far.
    expected: u32,
    crc: u32,
    trailer: Trailer,
}

impl Default for Scanner {
    fn default() -> Self {
        Self::new()
    }
}

impl Scanner {
    /// Nothing was read yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            position: 0,
            word: [0; WORD],
            magic: false,
            length: 0,
            expected: 0,
            crc: 0,
            trailer: Trailer::EMPTY,
        }
    }

    /// Takes the next bytes. Those beyond a sector do not count.
    // Once in flash, not at each of its callers.
    #[inline(never)]
    pub fn feed(&mut self, bytes: &[u8]) {
        let left = (SECTOR as usize).saturating_sub(self.position);
        for byte in bytes.iter().take(left) {
            let within = self.position.checked_sub(ENVELOPE_AT as usize);
            if within.is_some_and(|within| within < self.length) {
                self.crc = crc32_le(self.crc, &[*byte]);
            }
            if let Some(kept) = self.word.get_mut(self.position % WORD) {
                *kept = *byte;
            }
            self.position += 1;
            if self.position.is_multiple_of(WORD) {
                self.complete(self.position - WORD, u32::from_le_bytes(self.word));
            }
        }
    }

    /// A word that begins at `at` is complete.
    fn complete(&mut self, at: usize, word: u32) {
        match at {
            0 => self.magic = word == MAGIC,
            4 => {
                let length = word as u16;
                let fits = (1..=ENVELOPE_MAX).contains(&usize::from(length));
                if fits && word == length_word(length) {
                    self.length = usize::from(length);
                }
            }
            8 => self.expected = word,
            RECORDS_AT.. if word != u32::MAX => {
                self.trailer.free = at + WORD;
                if let Some(record) = Record::from_word(word) {
                    self.trailer.take(record);
                }
            }
            _ => {}
        }
    }

    /// What the bytes say. Those that are missing up to a whole sector count as blank.
    #[must_use]
    pub fn finish(self) -> Trailer {
        let read = self.position >= ENVELOPE_AT as usize + self.length;
        if self.magic && self.length > 0 && read && self.crc == self.expected {
            Trailer {
                envelope: Some(self.length as u16),
                ..self.trailer
            }
        } else {
            Trailer::EMPTY
        }
    }
}
