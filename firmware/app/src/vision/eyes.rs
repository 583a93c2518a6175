//! Who runs the detector, and in which memory.

use crawler_hal::FrameFormat;
use crawler_micromodel::{Model, ModelError, Runner, Shape, Step};
use embassy_futures::yield_now;

use super::cells::{MAX_CELLS, Spots, spots};
use super::class::Class;
use super::picture::{Picture, PictureError};

/// Label of the first channel of a detector: a cell that shows nothing.
const NOTHING: &str = "nothing";

/// Memory for looks, and a detector to make something of them.
///
/// A look is a value of its own: what it borrows is free again when it is dropped, wherever it was.
/// That a robot looks costs memory only while it does.
pub trait Eyes {
    /// One look.
    type Look<'e>: Look
    where
        Self: 'e;

    /// Begins a look with a frame of `bytes` bytes; `None` when there is not that much memory.
    fn open(&mut self, bytes: usize) -> Option<Self::Look<'_>>;
}

/// One look: memory for the frame, and what the detector makes of it.
pub trait Look {
    /// Memory for the frame, as long as was asked for.
    fn frame(&mut self) -> &mut [u8];

    /// Finds what the frame shows, a picture of `size` in `format`.
    ///
    /// # Errors
    /// When size and format do not go with the length of the frame.
    ///
    /// # Cancellation Safety
    /// A dropped call has found nothing; the next look begins anew.
    async fn find(self, size: (u16, u16), format: FrameFormat) -> Result<Spots, PictureError>;
}

/// Why a model is no detector that this program can use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DetectorError {
    /// It is no model, or the arena is too small for it.
    Model(ModelError),
    /// Its input is no picture of red, green and blue, or its output no picture of classes with
    /// at most [`MAX_CELLS`] cells.
    Shape,
    /// Its classes are not nothing and those of [`Class::ALL`], in this order.
    Labels,
}

impl core::fmt::Display for DetectorError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Model(error) => error.fmt(f),
            Self::Shape => f.write_str("its input or output is no picture of a size it may have"),
            Self::Labels => f.write_str("its classes are not those of this program"),
        }
    }
}

impl core::error::Error for DetectorError {}

impl From<ModelError> for DetectorError {
    fn from(error: ModelError) -> Self {
        Self::Model(error)
    }
}

/// A model that finds [`Class::ALL`] in pictures.
#[derive(Debug, Clone, Copy)]
pub struct Detector<'m>(Model<'m>);

impl<'m> Detector<'m> {
    /// Reads the model in `blob`.
    ///
    /// # Errors
    /// See [`DetectorError`].
    pub fn new(blob: &'m [u8]) -> Result<Self, DetectorError> {
        let model = Model::new(blob)?;
        let output = model.output();
        let cells = usize::from(output.height) * usize::from(output.width);
        let classes = usize::from(output.channels);
        if model.input().channels != 3 || cells > MAX_CELLS || classes != 1 + Class::ALL.len() {
            return Err(DetectorError::Shape);
        }
        let known = Class::ALL.iter().map(|class| class.name());
        if !model.labels().eq(core::iter::once(NOTHING).chain(known)) {
            return Err(DetectorError::Labels);
        }
        Ok(Self(model))
    }

    /// Bytes of memory that it runs in.
    pub fn arena_bytes(&self) -> usize {
        self.0.arena_bytes()
    }

    /// Multiplications of one look.
    pub fn multiplications(&self) -> u64 {
        self.0.multiplications()
    }

    /// The detector and the memory that it runs in; what is in there does not matter.
    ///
    /// # Errors
    /// [`DetectorError::Model`] when `arena` has fewer than [`Self::arena_bytes`].
    pub fn run_in<'a>(self, arena: &'a mut [i8]) -> Result<Finder<'m, 'a>, DetectorError> {
        let shapes = [self.0.input(), self.0.output()];
        let runner = Runner::new(self.0, arena)?;
        Ok(Finder { runner, shapes })
    }
}

/// A detector with memory to run in.
#[derive(Debug)]
pub struct Finder<'m, 'a> {
    runner: Runner<'m, 'a>,
    shapes: [Shape; 2],
}

impl Finder<'_, '_> {
    /// The logits of the last picture: rows of cells, each with a value for nothing and one for
    /// each of [`Class::ALL`].
    pub fn cells(&self) -> &[i8] {
        self.runner.output()
    }

    /// Finds what a picture shows, in one go: for a host, where nobody waits for the processor.
    /// Called where the processor's vectors are known to be there, it uses them.
    #[cfg_attr(
        target_pointer_width = "64",
        inline(always),
        allow(clippy::inline_always)
    )]
    pub fn find(&mut self, picture: &Picture<'_>) -> Spots {
        let [input, output] = self.shapes;
        let cells = self.runner.run(|row, out| picture.fill(input, row, out));
        spots(cells, output)
    }

    /// The same, row of a layer by row of a layer, and lets others run behind each: for a board,
    /// where the next row then waits for whoever has something to do. A row takes up to 200,000
    /// instructions (docs/counts.md): a millisecond, more or less.
    ///
    /// # Cancellation Safety
    /// A dropped call has found nothing; the next one begins anew.
    pub async fn find_gently(&mut self, picture: &Picture<'_>) -> Spots {
        let [input, output] = self.shapes;
        self.runner.restart();
        while let Step::More = self.runner.step(|row, out| picture.fill(input, row, out)) {
            yield_now().await;
        }
        spots(self.runner.output(), output)
    }
}

/// Eyes with memory of their own, which a board keeps in statics: the arena of the detector, and a
/// frame.
#[derive(Debug)]
pub struct OwnEyes<'m, 'a> {
    finder: Finder<'m, 'a>,
    frame: &'a mut [u8],
}

impl<'m, 'a> OwnEyes<'m, 'a> {
    /// Eyes with this memory. A camera whose frames are larger than `frame` shows them nothing.
    pub const fn new(finder: Finder<'m, 'a>, frame: &'a mut [u8]) -> Self {
        Self { finder, frame }
    }
}

impl<'m, 'a> Eyes for OwnEyes<'m, 'a> {
    type Look<'e>
        = OwnLook<'e, 'm, 'a>
    where
        Self: 'e;

    fn open(&mut self, bytes: usize) -> Option<OwnLook<'_, 'm, 'a>> {
        Some(OwnLook {
            frame: self.frame.get_mut(..bytes)?,
            finder: &mut self.finder,
        })
    }
}

/// A look of [`OwnEyes`].
#[derive(Debug)]
pub struct OwnLook<'e, 'm, 'a> {
    finder: &'e mut Finder<'m, 'a>,
    frame: &'e mut [u8],
}

impl Look for OwnLook<'_, '_, '_> {
    fn frame(&mut self) -> &mut [u8] {
        self.frame
    }

    async fn find(self, size: (u16, u16), format: FrameFormat) -> Result<Spots, PictureError> {
        let picture = Picture::new(self.frame, size, format)?;
        Ok(self.finder.find_gently(&picture).await)
    }
}

/// The eyes of a robot that has none.
#[derive(Debug, Clone, Copy)]
pub enum NoEyes {}

impl Eyes for NoEyes {
    type Look<'e> = NoLook;

    fn open(&mut self, _: usize) -> Option<NoLook> {
        match *self {}
    }
}

/// A look that nobody takes.
#[derive(Debug, Clone, Copy)]
pub enum NoLook {}

impl Look for NoLook {
    fn frame(&mut self) -> &mut [u8] {
        match *self {}
    }

    async fn find(self, _: (u16, u16), _: FrameFormat) -> Result<Spots, PictureError> {
        match self {}
    }
}
