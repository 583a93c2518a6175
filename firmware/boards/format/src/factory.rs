//! What a launcher writes into the banks before the machine starts, as a cable does with a board.

use std::vec;
use std::vec::Vec;

use crawler_boot::flash::SECTOR;
use sha2::{Digest as _, Sha256};

use crate::layout::{FLASHED, Group, OTADATA, SLOT_BYTES, SLOTS};

/// What stands before the hash of the image that was put there last.
const MARK: &[u8; 8] = b"TCFLASH1";

/// Bytes at [`FLASHED`] that tell which image was put there last.
pub const MARK_BYTES: usize = MARK.len() + 32;

/// What stands at [`FLASHED`] in a bank that `image` was put into. While it stands there a launcher leaves the bank
/// alone: the image may have been updated since.
#[must_use]
pub fn mark(image: &[u8]) -> Vec<u8> {
    let hash = Sha256::digest(image);
    [&MARK[..], hash.as_slice()].concat()
}

/// What is to be written where in the second bank to have `image` start from slot 0: the slot, blank select
/// entries, and the mark last. Parameters and what is in slot 1 stay.
#[must_use]
pub fn writes(image: &[u8]) -> Vec<(u32, Vec<u8>)> {
    let mut slot = image.to_vec();
    slot.resize(SLOT_BYTES as usize, 0xFF);
    let blank = vec![0xFF; 2 * SECTOR as usize];
    let mut writes = Vec::new();
    // Select entries first: whatever happens between, slot 0 is tried.
    for (start, bytes) in [(OTADATA, &blank), (SLOTS[0], &slot)] {
        for piece in Group::pieces(start, bytes.len()).into_iter().flatten() {
            writes.push((piece.offset, bytes[piece.from..piece.to].to_vec()));
        }
    }
    writes.push((FLASHED, mark(image)));
    writes
}
