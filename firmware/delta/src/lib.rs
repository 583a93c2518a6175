//! Reads a delta: a patch that makes a new image out of the one that a robot already has.
//!
//! The format is that of [detools](https://github.com/eerimoq/detools) 0.53, `create_patch --type sequential
//! --compression heatshrink`, without its data formats:
//!
//! | bytes | what |
//! |---|---|
//! | 1 | type and compression: `0x04` |
//! | 1 to 5 | size of the new image, a number |
//! | 1 | parameters of heatshrink: window bits − 4 above, length bits − 3 below |
//! | the rest | what follows, compressed by heatshrink |
//!
//! | compressed | what |
//! |---|---|
//! | a number | 0: no data format |
//! | a number and so many bytes | differences: each added to the next byte of the old image |
//! | a number and so many bytes | bytes of the new image as they are |
//! | a number | how far to go on, or back, in the old image |
//!
//! The last three rows are a record; records follow each other until the new image is whole. A number has its
//! sign in bit 6 of its first byte, six bits there and seven in each byte that follows, the lowest first; bit 7
//! says that one follows. In the stream of heatshrink, highest bit first, 1 and eight bits are a byte; 0,
//! distance − 1 and length − 1 are a copy of earlier bytes, of which the ones before the first are zeros.
//!
//! # Use
//!
//! [`Decoder`] neither reads the old image nor writes the new one. It is handed the patch in pieces of any
//! length and says, [`Step`] by step, which bytes come next and which part of the old image is to be added to
//! them ([`add`]), so that whoever owns the flash decides when it is read and written.
//!
//! ```
//! use crawler_delta::{Decoder, Step, add};
//!
//! let old = b"forward";
//! // As detools makes it from these seven bytes and `backward`.
//! let patch: [u8; 17] = [
//!     0x04, 0x08, 0x44, 0x80, 0x40, 0x21, 0x16, 0x2b, 0x0d, 0x8e, 0xd7, 0x77, 0xb0, 0xdc, 0xac, 0x90, 0x60,
//! ];
//! let mut decoder = Decoder::new(old.len() as u32, 8);
//! let (mut new, mut out) = (Vec::new(), [0; 4]);
//! for mut piece in patch.chunks(5) {
//!     loop {
//!         match decoder.step(&mut piece, &mut out)? {
//!             Step::Made { length, old: from } => {
//!                 if let Some(from) = from {
//!                     add(&mut out[..length], &old[from as usize..]);
//!                 }
//!                 new.extend_from_slice(&out[..length]);
//!             }
//!             Step::More | Step::Done => break,
//!         }
//!     }
//! }
//! decoder.finish()?;
//! assert_eq!(new, b"backward");
//! # Ok::<(), crawler_delta::DeltaError>(())
//! ```
//!
//! # Trust
//!
//! A patch has no signature and no checksum, and needs none: what it makes is held against the hashes of the
//! signed manifest of the new image, block by block, before anything is started. So it may be anything. No
//! patch makes the decoder panic, read outside of the old image, make more than was announced, or go on
//! without an end: a step does no more than fill the buffer that it is given and read the numbers of two
//! records, and a patch has at most one record more than the new image has bytes.
//!
//! # Interruption
//!
//! Between two pieces the state is the decoder, which can wait for as long as the power is on. After a restart
//! the patch is read again from its beginning, and what was written before is passed over
//! ([`Decoder::made`]): the pieces travel once more, and decoding costs what it did, but neither is the old
//! image read for that part nor flash erased or written. To keep the decoder itself in flash, more than a
//! kilobyte at each stop, would wear the flash for what happens rarely.
//!
//! # Memory
//!
//! A [`Decoder`] has [`WINDOW`] bytes of window and at most 56 for everything else, and its user two buffers:
//! one to fill, one of the same length for the old image.
//!
//! # Reading order
//!
//! `number` and `heatshrink`, each on its own; then `decoder`, with what can be wrong in `error`.
#![no_std]

#[cfg(test)]
extern crate std;

mod decoder;
mod error;
mod heatshrink;
mod number;

pub use decoder::{Decoder, Step, add};
pub use error::DeltaError;

/// Most bits of the window of a patch: a copy reaches back by 2 to the power of that.
pub const WINDOW_BITS: u8 = 10;

/// Least bits of the window of a patch (heatshrink, `HEATSHRINK_MIN_WINDOW_BITS`).
pub const LEAST_WINDOW_BITS: u8 = 4;

/// Least bits of the length of a copy (heatshrink, `HEATSHRINK_MIN_LOOKAHEAD_BITS`). The most are one less than
/// the window has.
pub const LEAST_LENGTH_BITS: u8 = 3;

/// Bytes of the window that a decoder keeps.
pub const WINDOW: usize = 1 << WINDOW_BITS;
