//! A picture, with what each pixel shows.

use super::rays::Rays;
use super::scene::Scene;

/// Width and height of the frames that vision works on, in pixels.
pub const FRAME_SIDE: u16 = 96;

/// Largest width and height of a frame, in pixels.
const LARGEST: u16 = 2_048;

/// What a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Seen {
    /// Nothing: above the walls.
    #[default]
    Sky,
    /// The ground.
    Floor,
    /// One of the walls around the arena.
    Wall,
    /// The obstacle of this index.
    Obstacle(u32),
    /// The moving obstacle of this index.
    Mover(u32),
    /// The object of this index.
    Object(u32),
    /// The robot of this index.
    Robot(u32),
}

/// Where in a picture a thing is, as far as it is not hidden.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// What it is.
    pub of: Seen,
    /// Middle of its pixels, counted from the left edge.
    pub x: f32,
    /// Middle of its pixels, counted from the top edge.
    pub y: f32,
    /// How many pixels show it.
    pub pixels: u32,
}

/// A frame has 1 to 2,048 pixels along each side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameSizeError;

impl core::fmt::Display for FrameSizeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "a frame has 1 to {LARGEST} pixels along each side")
    }
}

impl core::error::Error for FrameSizeError {}

/// A picture: colour, depth and name of every pixel, row by row from the top left.
///
/// Keeps its memory from picture to picture; a thread needs one, however many robots look.
#[derive(Debug, Clone)]
pub struct Frame {
    width: u16,
    height: u16,
    pub(super) rgb: Vec<u8>,
    pub(super) depth: Vec<f32>,
    pub(super) seen: Vec<Seen>,
    pub(crate) scene: Scene,
    pub(super) rays: Rays,
    /// The picture before it is blurred.
    pub(super) sharp: Vec<u8>,
}

impl Frame {
    /// A black frame.
    ///
    /// # Errors
    /// [`FrameSizeError`] when a side has no pixels, or more than 2,048.
    pub fn new(width: u16, height: u16) -> Result<Self, FrameSizeError> {
        if !(1..=LARGEST).contains(&width) || !(1..=LARGEST).contains(&height) {
            return Err(FrameSizeError);
        }
        let pixels = usize::from(width) * usize::from(height);
        Ok(Self {
            width,
            height,
            rgb: vec![0; pixels * 3],
            depth: vec![f32::INFINITY; pixels],
            seen: vec![Seen::Sky; pixels],
            scene: Scene::default(),
            rays: Rays::default(),
            sharp: Vec::new(),
        })
    }

    /// A frame as vision wants it: [`FRAME_SIDE`] pixels along each side.
    pub fn square() -> Self {
        Self::new(FRAME_SIDE, FRAME_SIDE)
            .unwrap_or_else(|FrameSizeError| unreachable!("{FRAME_SIDE} is a size"))
    }

    /// Pixels of a row.
    pub const fn width(&self) -> u16 {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> u16 {
        self.height
    }

    /// Red, green and blue of every pixel.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// Every pixel in two bytes, the first with the high bits: 5 of red, 6 of green, 5 of blue, as
    /// small cameras send them. Pixels for which there is no room are left out.
    pub fn rgb565(&self, bytes: &mut [u8]) {
        for (bytes, pixel) in bytes.chunks_exact_mut(2).zip(self.rgb.chunks_exact(3)) {
            let [red, green, blue] = [0, 1, 2].map(|channel: usize| u16::from(pixel[channel]));
            let packed = (red >> 3) << 11 | (green >> 2) << 5 | blue >> 3;
            bytes.copy_from_slice(&packed.to_be_bytes());
        }
    }

    /// The same, for a camera model to work on.
    pub fn rgb_mut(&mut self) -> &mut [u8] {
        &mut self.rgb
    }

    /// Colour of a pixel; `None` outside of the frame.
    pub fn colour(&self, x: u16, y: u16) -> Option<[u8; 3]> {
        let at = self.index(x, y)? * 3;
        self.rgb.get(at..at + 3)?.try_into().ok()
    }

    /// What a pixel shows; `None` outside of the frame.
    pub fn seen(&self, x: u16, y: u16) -> Option<Seen> {
        self.seen.get(self.index(x, y)?).copied()
    }

    /// Distance along the optical axis to what a pixel shows, metres; infinite for the sky, `None`
    /// outside of the frame.
    pub fn depth(&self, x: u16, y: u16) -> Option<f32> {
        self.depth.get(self.index(x, y)?).copied()
    }

    /// Everything in the picture but ground, walls and sky, in order of kind and index: the truth
    /// that a detector is to find.
    pub fn spots(&self) -> Vec<Spot> {
        let mut sums: std::collections::BTreeMap<Seen, [u32; 3]> =
            std::collections::BTreeMap::new();
        for (at, &seen) in self.seen.iter().enumerate() {
            if !matches!(seen, Seen::Sky | Seen::Floor | Seen::Wall) {
                let width = usize::from(self.width);
                let sum = sums.entry(seen).or_default();
                sum[0] += (at % width) as u32;
                sum[1] += (at / width) as u32;
                sum[2] += 1;
            }
        }
        sums.into_iter()
            .map(|(of, [x, y, pixels])| Spot {
                of,
                x: x as f32 / pixels as f32 + 0.5,
                y: y as f32 / pixels as f32 + 0.5,
                pixels,
            })
            .collect()
    }

    fn index(&self, x: u16, y: u16) -> Option<usize> {
        (x < self.width && y < self.height)
            .then(|| usize::from(y) * usize::from(self.width) + usize::from(x))
    }
}
