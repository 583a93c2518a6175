//! The image out of the program that runs, as a patch says: what comes next, piece by piece, and where it goes.
//!
//! A patch is read once from its beginning to its end, over all its chunks. Nobody has signed it, so it may say
//! anything: what it makes counts once a block is what was signed, and it reads nothing but the slot that runs.

use crawler_boot::flash::WORD;
use crawler_delta::{Decoder, DeltaError, Step, add};
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::mailbox::Updates;
use super::transfer::{Blocks, Failed, Shape};

/// Bytes of the image that are written at once.
pub(super) const PIECE: usize = 128;
/// Bytes of the patch that are read at once.
const READ: usize = 64;

// A piece lies in one block.
const _: () = assert!(crawler_release::BLOCK_SIZES[0].is_multiple_of(PIECE as u32));
const _: () = assert!(PIECE.is_multiple_of(WORD));

/// What comes next of a piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Made {
    /// Where in the piece, and how many bytes.
    from: usize,
    pub(super) length: usize,
    /// Where in the slot that runs the bytes are that have to be added to it.
    pub(super) old: Option<u32>,
    /// It is of a block that is there already.
    is_there: bool,
}

/// See the [module](self).
pub(super) struct Patch {
    decoder: Decoder,
    piece: [u8; PIECE],
    shape: Option<Shape>,
    pub(super) there: Blocks,
    /// Bytes of the chunk that waits that were read.
    read: usize,
    is_used_up: bool,
}

impl Patch {
    /// Of nothing.
    pub(super) const NONE: Self = Self {
        decoder: Decoder::new(0, 0),
        piece: [0; PIECE],
        shape: None,
        there: Blocks::NONE,
        read: 0,
        is_used_up: false,
    };

    /// Begins with an image of that shape, out of what is in a slot of `capacity` bytes.
    #[inline(never)]
    pub(super) fn begin(&mut self, capacity: u32, shape: Shape) {
        self.decoder = Decoder::new(capacity, shape.size());
        self.shape = Some(shape);
        self.read = 0;
    }

    /// How much of the image is made, once the chunk is used up.
    pub(super) fn made(&self) -> Option<u32> {
        self.is_used_up.then(|| self.decoder.made())
    }

    /// What comes next of the chunk that waits, of this length; `None` once that is used up.
    #[inline(never)]
    pub(super) fn next<M: RawMutex, const MODELS: usize>(
        &mut self,
        place: &Updates<M, MODELS>,
        length: usize,
    ) -> Result<Option<Made>, Failed> {
        let made = self.decoder.made();
        let from = made as usize % PIECE;
        loop {
            let mut bytes = [0; READ];
            let count = length.saturating_sub(self.read).min(READ);
            place.copy_out(self.read, &mut bytes[..count]);
            let mut rest = &bytes[..count];
            let step = self.decoder.step(&mut rest, &mut self.piece[from..]);
            self.read += count - rest.len();
            match step.map_err(failed)? {
                Step::Made { length, old } => {
                    self.is_used_up = false;
                    let block = self.shape.map(|shape| shape.block_of(made));
                    let is_there = block.is_none_or(|block| self.there.has(block));
                    return Ok(Some(Made {
                        from,
                        length,
                        old: old.filter(|_| !is_there),
                        is_there,
                    }));
                }
                Step::More | Step::Done if self.read < length => {}
                Step::More | Step::Done => {
                    self.read = 0;
                    self.is_used_up = true;
                    return Ok(None);
                }
            }
        }
    }

    /// Adds the bytes of the slot that runs to what came next.
    pub(super) fn add(&mut self, made: &Made, old: &[u8]) {
        add(&mut self.piece[made.from..][..made.length], old);
    }

    /// The piece and where it goes, in bytes from the start of the slot, once it is whole and to be written.
    pub(super) fn full(&mut self, made: &Made) -> Option<(u32, &[u8])> {
        let end = made.from + made.length;
        let until = self.decoder.made();
        let is_last = self.shape.is_some_and(|shape| shape.size() == until);
        if made.is_there || made.length == 0 || (end < PIECE && !is_last) {
            return None;
        }
        // What is left of the last word programs nothing.
        let words = end.next_multiple_of(WORD);
        self.piece[end..words].fill(0xFF);
        Some((until - end as u32, &self.piece[..words]))
    }
}

const fn failed(error: DeltaError) -> Failed {
    Failed::Patch(error.code())
}
