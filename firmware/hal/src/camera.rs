//! One frame at a time.

/// How the pixels of a frame are laid out, row by row from the top left.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameFormat {
    /// One byte a pixel, 0 black to 255 white.
    Grey8,
    /// Two bytes a pixel, big-endian, 5 bits red, 6 green, 5 blue.
    Rgb565,
}

/// What kind of failure a camera's error is. Each kind calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CameraErrorKind {
    /// No sensor answers on the control bus: cable or power.
    Absent,
    /// The sensor is there and sends no frame, or none that ends.
    Stalled,
    /// The picture does not fit the caller's buffer: try a larger one, or a duller view.
    TooLarge,
    /// The sensor sent something that is no picture.
    Garbled,
    /// The caller's buffer has the wrong length for a frame: a mistake of the program.
    Length,
    /// Anything else.
    Other,
}

/// An error of a camera, of which the program needs to know the kind.
pub trait CameraError: core::fmt::Debug {
    /// What kind of failure it is.
    fn kind(&self) -> CameraErrorKind;
}

impl CameraError for CameraErrorKind {
    fn kind(&self) -> CameraErrorKind {
        *self
    }
}

/// A camera that writes pictures into a caller's buffer: frames for vision, stills for people.
///
/// Every call ends within a time the implementation states, also when the sensor is absent or
/// stuck; the program bounds it once more.
pub trait Camera {
    /// Why there is no picture.
    type Error: CameraError;

    /// Width and height of a frame, in pixels.
    fn size(&self) -> (u16, u16);

    /// Layout of the pixels of a frame.
    fn format(&self) -> FrameFormat;

    /// Takes one frame into `frame`, which is exactly width × height × bytes per pixel long.
    ///
    /// # Errors
    /// When `frame` has another length, or the sensor is absent or stalls.
    ///
    /// # Cancellation Safety
    /// A dropped call leaves `frame` partly written; the next call starts a new frame.
    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), Self::Error>;

    /// Takes one still as a JPEG (ISO/IEC 10918-1, from SOI to EOI) to the front of `jpeg`, and
    /// returns its length. Its size in pixels is the camera's own choice.
    ///
    /// # Errors
    /// [`CameraErrorKind::TooLarge`] when it does not fit; [`CameraErrorKind::Absent`],
    /// [`CameraErrorKind::Stalled`] or [`CameraErrorKind::Garbled`] when there is none.
    ///
    /// # Cancellation Safety
    /// A dropped call leaves `jpeg` partly written; the next call starts a new still.
    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, Self::Error>;
}

impl<T: Camera> Camera for &mut T {
    type Error = T::Error;

    fn size(&self) -> (u16, u16) {
        T::size(self)
    }

    fn format(&self) -> FrameFormat {
        T::format(self)
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), Self::Error> {
        T::capture(self, frame).await
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, Self::Error> {
        T::still(self, jpeg).await
    }
}

/// The camera of a body that has none.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoCamera;

/// There is no camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoCameraError;

impl CameraError for NoCameraError {
    fn kind(&self) -> CameraErrorKind {
        CameraErrorKind::Absent
    }
}

impl Camera for NoCamera {
    type Error = NoCameraError;

    fn size(&self) -> (u16, u16) {
        (0, 0)
    }

    fn format(&self) -> FrameFormat {
        FrameFormat::Grey8
    }

    async fn capture(&mut self, _frame: &mut [u8]) -> Result<(), NoCameraError> {
        Err(NoCameraError)
    }

    async fn still(&mut self, _jpeg: &mut [u8]) -> Result<usize, NoCameraError> {
        Err(NoCameraError)
    }
}
