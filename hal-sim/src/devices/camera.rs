//! What the robot would see: small pictures of the real geometry.

use crawler_hal::{Camera, CameraError, CameraErrorKind, Clock, Duration, FrameFormat};
use rand_core::Rng;

use super::ports::Wire;
use crate::faults::CameraFault;
use crate::render::{self, Frame};

/// Width and height of a frame, in pixels.
pub const CAMERA_SIDE: u16 = 96;
/// Bytes of a frame.
pub(crate) const FRAME_BYTES: usize = CAMERA_SIDE as usize * CAMERA_SIDE as usize * 2;
/// Width and height of a still, in pixels.
pub const STILL_SIZE: (u16, u16) = (320, 240);

/// From the call to the last byte: one frame at 30 a second.
const FRAME_TIME: Duration = Duration::from_micros(33_333);
/// A still takes a change of mode, and frames until exposure has settled.
const STILL_TIME: Duration = Duration::from_millis(250);
/// How long a driver asks a sensor that is not there.
const ABSENT_AFTER: Duration = Duration::from_millis(5);
/// Quality of stills, 1 to 100.
const QUALITY: u8 = 75;

/// A camera that looks forward, see [`crate::world::Camera`]: frames of 96 × 96 pixels of two bytes,
/// stills of 320 × 240. Its imperfections are those of [`crate::world::Look`].
#[derive(Debug)]
pub struct SimCamera {
    wire: Wire,
}

/// Why there is no picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LensError {
    /// The buffer is not exactly one frame long.
    Length,
    /// The still does not fit the buffer.
    TooLarge,
    /// No sensor answers.
    Absent,
    /// The body behind this camera was reset or lost its power.
    Disconnected,
}

impl CameraError for LensError {
    fn kind(&self) -> CameraErrorKind {
        match self {
            Self::Length => CameraErrorKind::Length,
            Self::TooLarge => CameraErrorKind::TooLarge,
            Self::Absent | Self::Disconnected => CameraErrorKind::Absent,
        }
    }
}

/// What a sensor that works, more or less, delivers.
enum Signal {
    Picture,
    Garbage,
}

impl SimCamera {
    pub(crate) const fn new(wire: Wire) -> Self {
        Self { wire }
    }

    /// Waits as long as a picture takes.
    async fn expose(&self, span: Duration) -> Result<Signal, LensError> {
        if !self.wire.is_live() {
            return Err(LensError::Disconnected);
        }
        let clock = self.wire.clock();
        let signal = match self.wire.ports.faults.get().camera {
            None => Signal::Picture,
            Some(CameraFault::Garbage) => Signal::Garbage,
            Some(CameraFault::Absent) => {
                clock.sleep(ABSENT_AFTER).await;
                return Err(LensError::Absent);
            }
            // Worse than the shipped driver, which gives up: the program's own bound must hold.
            Some(CameraFault::Stalled) => core::future::pending().await,
        };
        clock.sleep(span).await;
        if self.wire.is_live() {
            Ok(signal)
        } else {
            Err(LensError::Disconnected)
        }
    }

    /// Draws what the lens sees, and hands it over.
    fn render<T>(
        &self,
        (width, height): (u16, u16),
        develop: impl FnOnce(&Frame) -> T,
    ) -> Option<T> {
        let ports = &self.wire.ports;
        let mut frame = ports.shared.frame.borrow_mut();
        let fits = |frame: &Frame| frame.width() == width && frame.height() == height;
        if !frame.as_ref().is_some_and(fits) {
            *frame = Frame::new(width, height).ok();
        }
        let frame = frame.as_mut()?;
        render::view(&mut ports.shared.space.borrow_mut(), ports.index(), frame);
        Some(develop(frame))
    }

    fn fill_with_noise(&self, bytes: &mut [u8]) {
        self.wire.ports.camera_rng.borrow_mut().fill_bytes(bytes);
    }
}

impl Camera for SimCamera {
    type Error = LensError;

    fn size(&self) -> (u16, u16) {
        (CAMERA_SIDE, CAMERA_SIDE)
    }

    fn format(&self) -> FrameFormat {
        FrameFormat::Rgb565
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), LensError> {
        if frame.len() != FRAME_BYTES {
            return Err(LensError::Length);
        }
        match self.expose(FRAME_TIME).await? {
            Signal::Garbage => self.fill_with_noise(frame),
            Signal::Picture => {
                self.render((CAMERA_SIDE, CAMERA_SIDE), |drawn| drawn.rgb565(frame));
            }
        }
        Ok(())
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, LensError> {
        if let Signal::Garbage = self.expose(STILL_TIME).await? {
            self.fill_with_noise(jpeg);
            return Ok(jpeg.len());
        }
        let (width, height) = STILL_SIZE;
        let encoded = self.render(STILL_SIZE, |drawn| {
            let mut encoded = Vec::new();
            jpeg_encoder::Encoder::new(&mut encoded, QUALITY)
                .encode(drawn.rgb(), width, height, jpeg_encoder::ColorType::Rgb)
                .map(|()| encoded)
        });
        // Only sizes of zero cannot be drawn or encoded, and a `Vec` takes every byte.
        let Some(Ok(encoded)) = encoded else {
            return Err(LensError::TooLarge);
        };
        let target = jpeg.get_mut(..encoded.len()).ok_or(LensError::TooLarge)?;
        target.copy_from_slice(&encoded);
        Ok(encoded.len())
    }
}
