//! The records of a patch, and what they make.

use crate::heatshrink::Heatshrink;
use crate::number::Number;
use crate::{DeltaError, WINDOW};

/// Type and compression of a patch: sequential, heatshrink.
const TYPE: u8 = 0x04;

/// What comes of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The piece of the patch is used up. The next one is wanted, at the next step.
    More,
    /// The next bytes of the new image are at the front of the buffer.
    Made {
        /// How many; 0 at the end of a record.
        length: usize,
        /// Where in the old image as many bytes lie that have to be added to them first, see [`add`]; all of
        /// them are within it. `None` when they are right as they are.
        old: Option<u32>,
    },
    /// The new image is whole.
    Done,
}

/// Adds to the bytes of a step those of the old image, byte by byte and modulo 256; the shorter of the two
/// ends it.
pub fn add(made: &mut [u8], old: &[u8]) {
    for (made, old) in made.iter_mut().zip(old) {
        *made = made.wrapping_add(*old);
    }
}

/// What the next byte of the patch is, or belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Type,
    Size,
    Parameters,
    DataFormat,
    DifferencesSize,
    Differences,
    BytesSize,
    Bytes,
    Move,
    Done,
    Failed(DeltaError),
}

/// Reads a patch, and gives the new image out in order.
#[derive(Debug, Clone)]
pub struct Decoder {
    heatshrink: Heatshrink,
    number: Number,
    state: State,
    /// Bytes of both images.
    old: u32,
    new: u32,
    /// Where in the old image the next differences begin.
    at: u32,
    /// Bytes that were given out.
    made: u32,
    /// Bytes that are left of a part of the record.
    left: u32,
    /// Records that may still follow another.
    records: u32,
}

const _: () = assert!(size_of::<Decoder>() <= WINDOW + 56);

impl Decoder {
    /// Begins to read a patch from an image of `old` bytes to one of `new` bytes.
    #[must_use]
    pub const fn new(old: u32, new: u32) -> Self {
        Self {
            heatshrink: Heatshrink::new(),
            number: Number::new(),
            state: State::Type,
            old,
            new,
            at: 0,
            made: 0,
            left: 0,
            // In what detools makes, each but the first stands for a byte of the image at least.
            records: new,
        }
    }

    /// How many bytes of the new image were given out.
    #[must_use]
    pub const fn made(&self) -> u32 {
        self.made
    }

    /// Takes what it can use off the front of `patch`, and says what came of it. To be called again with what
    /// is left of the piece until that says [`Step::More`], also when nothing is left of it: a few bytes of a
    /// patch can stand for many of the image. Into an empty buffer nothing can be made.
    ///
    /// # Errors
    /// [`DeltaError`] says what is wrong with the patch. The same comes of every later step.
    pub fn step(&mut self, patch: &mut &[u8], out: &mut [u8]) -> Result<Step, DeltaError> {
        let step = self.advance(patch, out);
        if let Err(error) = step {
            self.state = State::Failed(error);
        }
        step
    }

    /// To be asked when there is no more of the patch.
    ///
    /// # Errors
    /// [`DeltaError::CutOff`] when the new image is not whole, or what was wrong before.
    pub const fn finish(&self) -> Result<(), DeltaError> {
        match self.state {
            State::Done => Ok(()),
            State::Failed(error) => Err(error),
            _ => Err(DeltaError::CutOff),
        }
    }

    fn advance(&mut self, patch: &mut &[u8], out: &mut [u8]) -> Result<Step, DeltaError> {
        loop {
            match self.state {
                State::Failed(error) => return Err(error),
                State::Done if patch.is_empty() && !self.heatshrink.has_more() => {
                    return Ok(Step::Done);
                }
                State::Done => return Err(DeltaError::Trailing),
                State::Differences | State::Bytes => {
                    if self.left > 0 {
                        return Ok(self.make(patch, out));
                    }
                    self.state = if self.state == State::Bytes {
                        State::Move
                    } else {
                        State::BytesSize
                    };
                }
                _ => {
                    let Some(byte) = self.next_byte(patch) else {
                        return Ok(Step::More);
                    };
                    if self.take(byte)? {
                        return Ok(Step::Made {
                            length: 0,
                            old: None,
                        });
                    }
                }
            }
        }
    }

    /// The next byte of the patch, of which the first ones are not compressed.
    fn next_byte(&mut self, patch: &mut &[u8]) -> Option<u8> {
        if matches!(self.state, State::Type | State::Size | State::Parameters) {
            let (byte, rest) = patch.split_first()?;
            *patch = rest;
            return Some(*byte);
        }
        let mut byte = [0];
        (self.heatshrink.read(patch, &mut byte) == 1).then_some(byte[0])
    }

    /// Takes a byte that does not belong to the image. Whether that was the end of a record.
    fn take(&mut self, byte: u8) -> Result<bool, DeltaError> {
        match self.state {
            State::Type => {
                if byte != TYPE {
                    return Err(DeltaError::Type);
                }
                self.state = State::Size;
                return Ok(false);
            }
            State::Parameters => {
                self.heatshrink.configure(byte)?;
                self.state = State::DataFormat;
                return Ok(false);
            }
            _ => {}
        }
        let Some(number) = self.number.push(byte)? else {
            return Ok(false);
        };
        if self.state == State::Move {
            return self.end_record(number).map(|()| true);
        }
        let size = u32::try_from(number).map_err(|_| DeltaError::Number)?;
        self.state = match self.state {
            State::Size if size != self.new => return Err(DeltaError::Size),
            // Nothing follows: detools ends such a patch here.
            State::Size if size == 0 => State::Done,
            State::Size => State::Parameters,
            State::DataFormat if size != 0 => return Err(DeltaError::DataFormat),
            State::DataFormat => State::DifferencesSize,
            // All that is left are the sizes of both parts of a record.
            _ if size > self.new - self.made => return Err(DeltaError::TooLong),
            State::DifferencesSize if size > self.old - self.at => {
                return Err(DeltaError::Outside);
            }
            State::DifferencesSize => State::Differences,
            _ => State::Bytes,
        };
        self.left = size;
        Ok(false)
    }

    fn end_record(&mut self, distance: i32) -> Result<(), DeltaError> {
        let at = self.at.checked_add_signed(distance);
        self.at = at.filter(|at| *at <= self.old).ok_or(DeltaError::Outside)?;
        if self.made == self.new {
            self.state = State::Done;
        } else {
            self.records = self.records.checked_sub(1).ok_or(DeltaError::Records)?;
            self.state = State::DifferencesSize;
        }
        Ok(())
    }

    /// Makes bytes of the image: as many as the part of the record has, the buffer takes, and the piece gives.
    fn make(&mut self, patch: &mut &[u8], out: &mut [u8]) -> Step {
        let most = out.len().min(self.left as usize);
        let length = self.heatshrink.read(patch, &mut out[..most]);
        if length == 0 && most > 0 {
            return Step::More;
        }
        let old = (self.state == State::Differences).then_some(self.at);
        if old.is_some() {
            self.at += length as u32;
        }
        self.left -= length as u32;
        self.made += length as u32;
        Step::Made { length, old }
    }
}
