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

/// A camera that writes frames into a caller's buffer.
pub trait Camera {
    /// Why there is no frame.
    type Error: core::fmt::Debug;

    /// Width and height of a frame, in pixels.
    fn size(&self) -> (u16, u16);

    /// Layout of the pixels.
    fn format(&self) -> FrameFormat;

    /// Takes one frame into `frame`, which is exactly width × height × bytes per pixel long.
    ///
    /// # Errors
    /// When `frame` has another length, or the sensor is absent or stalls.
    ///
    /// # Cancellation Safety
    /// A dropped call leaves `frame` partly written; the next call starts a new frame.
    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), Self::Error>;
}

/// The camera of a body that has none.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoCamera;

/// There is no camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoCameraError;

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
}
