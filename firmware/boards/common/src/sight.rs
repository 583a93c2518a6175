//! A detector looks at frames that are the same everywhere, and what it saw is told as text.
//!
//! A board and a host that tell the same agree on every logit and on every thing.

use core::fmt;

use crawler_app::vision::{Class, Finder, Picture, Spots};
use crawler_hal::FrameFormat;

/// Width and height of every frame.
pub const SIZE: (u16, u16) = (96, 96);
/// Layout of their pixels.
pub const FORMAT: FrameFormat = FrameFormat::Rgb565;
/// Bytes of a frame.
pub const BYTES: usize = SIZE.0 as usize * SIZE.1 as usize * 2;

/// One frame to look at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame<'f> {
    /// All pixels alike: name, and the bytes of one.
    Plain(&'f str, [u8; 2]),
    /// Colours that change evenly from edge to edge.
    Ramp,
    /// Squares of random colours, so many pixels wide.
    Noise(&'f str, u16),
    /// A frame of a camera, with its name.
    Taken(&'f str, &'f [u8; BYTES]),
}

/// Frames that a formula makes.
pub const MADE: [Frame<'static>; 7] = [
    Frame::Plain("black", [0x00, 0x00]),
    Frame::Plain("white", [0xFF, 0xFF]),
    Frame::Ramp,
    Frame::Noise("noise-1", 1),
    Frame::Noise("noise-4", 4),
    Frame::Noise("noise-12", 12),
    Frame::Noise("noise-32", 32),
];

impl<'f> Frame<'f> {
    /// What it is called.
    pub const fn name(&self) -> &'f str {
        match self {
            Self::Plain(name, _) | Self::Noise(name, _) | Self::Taken(name, _) => name,
            Self::Ramp => "ramp",
        }
    }

    /// Writes its bytes.
    pub fn write(&self, bytes: &mut [u8; BYTES]) {
        let width = usize::from(SIZE.0);
        let pixels = bytes.chunks_exact_mut(2);
        match *self {
            Self::Taken(_, taken) => bytes.copy_from_slice(taken),
            Self::Plain(_, colour) => pixels.for_each(|pixel| pixel.copy_from_slice(&colour)),
            Self::Ramp => pixels.enumerate().for_each(|(at, pixel)| {
                let (x, y) = (at % width, at / width);
                let (red, green, blue) = (x / 3, (x + y) / 3, y / 3);
                let colour = (red << 11 | green << 5 | blue) as u16;
                pixel.copy_from_slice(&colour.to_be_bytes());
            }),
            Self::Noise(_, grain) => {
                let grain = usize::from(grain.max(1));
                pixels.enumerate().for_each(|(at, pixel)| {
                    let square = at / width / grain * width + at % width / grain;
                    pixel.copy_from_slice(&(scattered(square as u32) as u16).to_be_bytes());
                });
            }
        }
    }
}

/// A number that says nothing about its neighbour's (the finaliser of `MurmurHash3`, Appleby).
const fn scattered(number: u32) -> u32 {
    let mixed = number.wrapping_add(0x9E37_79B9);
    let mixed = (mixed ^ (mixed >> 16)).wrapping_mul(0x85EB_CA6B);
    let mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0xC2B2_AE35);
    mixed ^ (mixed >> 16)
}

/// What a detector made of a frame. As text: a line `frame NAME HASH`, and for each thing a line
/// `spot NAME CLASS X Y MARGIN`, with the bits of X and Y.
#[derive(Debug, Clone, PartialEq)]
pub struct Sight<'f> {
    name: &'f str,
    /// FNV-1a of all logits (Fowler, Noll, Vo).
    hash: u64,
    spots: Spots,
}

impl Sight<'_> {
    /// How many things of a class there are.
    pub fn count(&self, class: Class) -> usize {
        self.spots.iter().filter(|spot| spot.class == class).count()
    }
}

impl fmt::Display for Sight<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name;
        write!(f, "frame {name} {:016x}", self.hash)?;
        for spot in &self.spots {
            let (x, y) = (spot.x.to_bits(), spot.y.to_bits());
            let class = spot.class.name();
            write!(f, "\nspot {name} {class} {x:08x} {y:08x} {}", spot.margin)?;
        }
        Ok(())
    }
}

/// Looks at the frame in `bytes`, called `name`, as a robot does. `None` when its length is wrong.
///
/// # Cancellation Safety
/// A dropped call has seen nothing; the next one begins anew.
pub async fn look<'f>(
    finder: &mut Finder<'_, '_>,
    name: &'f str,
    bytes: &[u8],
) -> Option<Sight<'f>> {
    let picture = Picture::new(bytes, SIZE, FORMAT).ok()?;
    let spots = finder.find_gently(&picture).await;
    let hash = finder
        .cells()
        .iter()
        .fold(0xCBF2_9CE4_8422_2325, |hash, &logit| {
            (hash ^ u64::from(logit as u8)).wrapping_mul(0x0000_0100_0000_01B3)
        });
    Some(Sight { name, hash, spots })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_app::vision::Detector;
    use crawler_detector::{BLOB, FRAMES};
    use embassy_futures::block_on;
    use std::boxed::Box;
    use std::format;
    use std::vec;
    use std::vec::Vec;

    fn empty() -> Box<[u8; BYTES]> {
        vec![0xAA; BYTES].try_into().expect("as many")
    }

    #[test]
    fn frames_differ_and_are_the_same_every_time() {
        let made = |frame: &Frame<'_>| {
            let mut bytes = empty();
            frame.write(&mut bytes);
            bytes
        };
        let all: Vec<_> = MADE.iter().map(made).collect();
        for (n, one) in all.iter().enumerate() {
            assert!(*one == made(&MADE[n]), "{}", MADE[n].name());
            for (other, which) in all[..n].iter().zip(&MADE) {
                assert!(one != other, "{} and {}", MADE[n].name(), which.name());
            }
        }
        assert!(all[0].iter().all(|&byte| byte == 0));
        // Green has the middle six bits; the last pixel is blue and red to the end of the ramp.
        assert_eq!(all[2][BYTES - 2..], [0b1111_1111, 0b1111_1111]);
        let mut colours: Vec<_> = all[3].chunks(2).collect();
        colours.sort_unstable();
        colours.dedup();
        assert!(colours.len() > 8_000, "{}", colours.len());
    }

    #[test]
    fn what_was_seen_is_told_bit_by_bit() {
        let detector = Detector::new(BLOB).expect("a detector");
        let mut arena = vec![0; detector.arena_bytes()];
        let mut finder = detector.run_in(&mut arena).expect("room");
        let mut bytes = empty();
        let mut hashes = Vec::new();
        for frame in MADE {
            frame.write(&mut bytes);
            let sight = block_on(look(&mut finder, frame.name(), &bytes[..])).expect("a frame");
            let again = block_on(look(&mut finder, frame.name(), &bytes[..])).expect("a frame");
            assert_eq!(sight, again);
            let text = format!("{sight}");
            assert!(text.starts_with(&format!("frame {} ", frame.name())));
            assert_eq!(text.lines().count(), 1 + sight.spots.len());
            hashes.push(sight.hash);
        }
        hashes.sort_unstable();
        hashes.dedup();
        assert_eq!(hashes.len(), MADE.len(), "every frame has its own hash");
        assert!(block_on(look(&mut finder, "short", &bytes[1..])).is_none());
        assert!(FRAMES.iter().all(|(name, _)| !name.contains(' ')));
    }
}
