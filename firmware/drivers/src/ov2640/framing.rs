//! From pieces of a byte stream to one picture in a caller's buffer.

use super::jpeg::{Step, Walker};

/// What is to be made of the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// As they are; the frame is as long as the buffer.
    Bytes,
    /// Every other byte of Y U Y V; the frame is twice as long as the buffer.
    Luma,
    /// One JPEG.
    Jpeg(Walker),
}

/// What has become of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It is not whole yet.
    More,
    /// It is whole, and this long in the buffer.
    Whole(usize),
    /// A JPEG does not fit the buffer.
    TooLarge,
}

/// A picture on its way into a buffer. Whatever comes, it writes nowhere else, and a frame that is
/// not whole at its end is dropped and the next one tried.
#[derive(Debug)]
pub struct Frame<'a> {
    buffer: &'a mut [u8],
    kind: Kind,
    /// Bytes of this frame so far, as they came.
    taken: usize,
    /// Bytes in the buffer.
    len: usize,
    too_large: bool,
    ends: u32,
}

impl<'a> Frame<'a> {
    const fn new(buffer: &'a mut [u8], kind: Kind) -> Self {
        Self {
            buffer,
            kind,
            taken: 0,
            len: 0,
            too_large: false,
            ends: 0,
        }
    }

    /// A frame as long as `buffer`.
    pub const fn bytes(buffer: &'a mut [u8]) -> Self {
        Self::new(buffer, Kind::Bytes)
    }

    /// The grey of a frame that comes as Y U Y V, twice as long as `buffer`.
    pub const fn luma_of_yuyv(buffer: &'a mut [u8]) -> Self {
        Self::new(buffer, Kind::Luma)
    }

    /// A JPEG that is at most as long as `buffer`.
    pub const fn jpeg(buffer: &'a mut [u8]) -> Self {
        Self::new(buffer, Kind::Jpeg(Walker::new()))
    }

    /// Ends of frames seen so far.
    #[must_use]
    pub const fn ends(&self) -> u32 {
        self.ends
    }

    /// Takes the next bytes. A JPEG is whole as soon as its last byte is there.
    pub fn take(&mut self, bytes: &[u8]) -> Verdict {
        match self.kind {
            Kind::Bytes => {
                let room = self.buffer.get_mut(self.taken..).unwrap_or_default();
                let count = room.len().min(bytes.len());
                room[..count].copy_from_slice(&bytes[..count]);
                self.len += count;
                self.taken = self.taken.saturating_add(bytes.len());
                Verdict::More
            }
            Kind::Luma => {
                for &byte in bytes {
                    if self.taken.is_multiple_of(2)
                        && let Some(pixel) = self.buffer.get_mut(self.taken / 2)
                    {
                        *pixel = byte;
                        self.len += 1;
                    }
                    self.taken = self.taken.saturating_add(1);
                }
                Verdict::More
            }
            Kind::Jpeg(mut walker) => {
                let verdict = self.walk(&mut walker, bytes);
                self.kind = Kind::Jpeg(walker);
                verdict
            }
        }
    }

    fn walk(&mut self, walker: &mut Walker, bytes: &[u8]) -> Verdict {
        for &byte in bytes {
            match walker.step(byte) {
                Step::Outside => {}
                Step::Broken => {
                    self.len = 0;
                    self.too_large = false;
                }
                Step::More => {
                    if self.len == 0 {
                        // The FF of SOI, which was taken for padding when it came.
                        self.put(0xFF);
                    }
                    self.put(byte);
                }
                Step::End => {
                    self.put(byte);
                    return if self.too_large {
                        Verdict::TooLarge
                    } else {
                        Verdict::Whole(self.len)
                    };
                }
            }
        }
        Verdict::More
    }

    fn put(&mut self, byte: u8) {
        match self.buffer.get_mut(self.len) {
            Some(place) => {
                *place = byte;
                self.len += 1;
            }
            None => self.too_large = true,
        }
    }

    /// The frame ends here; `so_far` is what its last bytes gave.
    pub fn end(&mut self, so_far: Verdict) -> Verdict {
        self.note_end();
        let whole = match self.kind {
            Kind::Bytes => self.taken == self.buffer.len(),
            Kind::Luma => self.taken == 2 * self.buffer.len(),
            Kind::Jpeg(_) => false,
        };
        if so_far == Verdict::More && whole {
            return Verdict::Whole(self.len);
        }
        // A JPEG whose beginning alone does not fit will not fit when its end is missing either.
        let verdict = if so_far == Verdict::More && self.too_large {
            Verdict::TooLarge
        } else {
            so_far
        };
        if verdict == Verdict::More {
            self.clear();
        }
        verdict
    }

    /// Notes the end of a frame that is not wanted.
    pub fn note_end(&mut self) {
        self.ends = self.ends.saturating_add(1);
    }

    /// Drops what was taken of this frame.
    pub fn clear(&mut self) {
        self.taken = 0;
        self.len = 0;
        self.too_large = false;
        if let Kind::Jpeg(walker) = &mut self.kind {
            *walker = Walker::new();
        }
    }
}
