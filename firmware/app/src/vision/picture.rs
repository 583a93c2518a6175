//! From a frame to the rows that a detector wants.

use crawler_hal::FrameFormat;
use crawler_micromodel::Shape;

/// Largest width and height of a frame, in pixels.
pub const LARGEST: u16 = 2_048;
/// Channels of a row: red, green, blue.
const CHANNELS: usize = 3;

/// Why bytes are no frame that can be looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureError {
    /// A side has no pixels, or more than [`LARGEST`].
    Size,
    /// There are more or fewer bytes than the size takes.
    Length,
    /// A layout of pixels that this program does not know.
    Format,
}

/// Bytes of a frame.
///
/// # Errors
/// [`PictureError::Size`] and [`PictureError::Format`].
pub const fn frame_bytes(
    (width, height): (u16, u16),
    format: FrameFormat,
) -> Result<usize, PictureError> {
    if width == 0 || height == 0 || width > LARGEST || height > LARGEST {
        return Err(PictureError::Size);
    }
    let pixels = width as usize * height as usize;
    match format {
        FrameFormat::Grey8 => Ok(pixels),
        FrameFormat::Rgb565 => Ok(pixels * 2),
        _ => Err(PictureError::Format),
    }
}

/// A frame as the camera left it.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'p> {
    bytes: &'p [u8],
    width: usize,
    height: usize,
    grey: bool,
}

impl<'p> Picture<'p> {
    /// The frame in `bytes`.
    ///
    /// # Errors
    /// See [`PictureError`].
    pub fn new(
        bytes: &'p [u8],
        size: (u16, u16),
        format: FrameFormat,
    ) -> Result<Self, PictureError> {
        if bytes.len() != frame_bytes(size, format)? {
            return Err(PictureError::Length);
        }
        Ok(Self {
            bytes,
            width: usize::from(size.0),
            height: usize::from(size.1),
            grey: format == FrameFormat::Grey8,
        })
    }

    /// Height over width.
    pub fn aspect(&self) -> f32 {
        self.height as f32 / self.width as f32
    }

    /// Writes row `row` of a picture of `shape`, which this one is stretched to: every pixel is
    /// the mean of those that it covers, or the one that it lies in. Values are those of the
    /// pixels less 128.
    ///
    /// A row that there is not is left as it is; so are values beyond a row.
    pub fn fill(&self, shape: Shape, row: usize, out: &mut [i8]) {
        if row >= usize::from(shape.height) {
            return;
        }
        let rows = covered(row, usize::from(shape.height), self.height);
        for (column, out) in out.chunks_exact_mut(CHANNELS).enumerate() {
            if column >= usize::from(shape.width) {
                return;
            }
            let columns = covered(column, usize::from(shape.width), self.width);
            let colour = self.mean(rows, columns);
            for (out, value) in out.iter_mut().zip(colour) {
                *out = (i16::from(value) - 128) as i8;
            }
        }
    }

    /// The mean colour of some pixels, rounded half up.
    fn mean(&self, rows: (usize, usize), columns: (usize, usize)) -> [u8; CHANNELS] {
        if rows.1 - rows.0 == 1 && columns.1 - columns.0 == 1 {
            return self.pixel(rows.0 * self.width + columns.0);
        }
        let mut sums = [0_u32; CHANNELS];
        for row in rows.0..rows.1 {
            for column in columns.0..columns.1 {
                for (sum, value) in sums.iter_mut().zip(self.pixel(row * self.width + column)) {
                    *sum += u32::from(value);
                }
            }
        }
        // Below 2²³ pixels of 255 at most, for a whole frame.
        let count = ((rows.1 - rows.0) * (columns.1 - columns.0)) as u32;
        sums.map(|sum| ((sum + count / 2) / count) as u8)
    }

    fn pixel(&self, at: usize) -> [u8; CHANNELS] {
        if self.grey {
            return [self.bytes.get(at).copied().unwrap_or(0); CHANNELS];
        }
        let [high, low] = match self.bytes.get(2 * at..2 * at + 2) {
            Some([high, low]) => [*high, *low],
            Some(_) | None => [0; 2],
        };
        let (red, blue) = (high >> 3, low & 0x1F);
        let green = (high & 0x07) << 3 | low >> 5;
        // The highest bits once more, so that white is white.
        [
            red << 3 | red >> 2,
            green << 2 | green >> 4,
            blue << 3 | blue >> 2,
        ]
    }
}

/// Which of `from` pixels pixel `at` of `to` covers: at least one.
const fn covered(at: usize, to: usize, from: usize) -> (usize, usize) {
    let begin = at * from / to;
    let end = (at + 1) * from / to;
    (begin, if end > begin { end } else { begin + 1 })
}
