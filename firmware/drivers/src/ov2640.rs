//! The OV2640 camera sensor: stills as JPEG, frames of 96 × 96 pixels for vision.
//!
//! What a board brings is an I²C bus for the control registers and a [`PixelPort`] for the
//! parallel data; everything else is here and runs on the host too. The sensor scales and crops by
//! itself, so a frame costs no more memory than its pixels:
//!
//! | mode | output of the sensor | what becomes of it |
//! |---|---|---|
//! | still | JPEG of 320 × 240 | copied from SOI to EOI, see [`jpeg`] |
//! | grey frame | 96 × 96 as Y U Y V | every other byte |
//! | RGB565 frame | 96 × 96, high byte first | as it is |
//!
//! # Time
//! Constructors do no I/O. Whatever the sensor does, [`Camera::still`] and [`Camera::capture`]
//! return within [`PICTURE_WITHIN`]; a sensor that sends no frame end for [`FRAME_WITHIN`] is
//! given up before. After a failure the sensor is probed and set up anew, so one that is plugged
//! in again works again.
//!
//! # Sources
//! The maker's data sheet *OV2640 Color CMOS UXGA* 1.6 of 28 February 2006: table 12 (registers of
//! the DSP) and table 13 (registers of the sensor). The maker's *SCCB Functional Specification*
//! 2.2. The tables in [`registers`] say where a value comes from. Undocumented registers stay as
//! reset leaves them.

mod control;
pub mod framing;
pub mod jpeg;
pub mod registers;

#[cfg(test)]
mod tests;

use crawler_hal::{
    Camera, CameraError, CameraErrorKind, Clock, Duration, FrameFormat, Instant, with_deadline,
};
use embedded_hal_async::i2c::I2c;

use control::Control;
use framing::{Frame, Verdict};
use registers::Mode;

/// Width and height of a frame for vision, in pixels.
pub const FRAME_SIDE: u16 = 96;
/// Width and height of a still, in pixels.
pub const STILL_SIZE: (u16, u16) = (320, 240);
/// Longest time for one picture, set-up included.
pub const PICTURE_WITHIN: Duration = Duration::from_secs(2);
/// Longest time between the ends of two frames. The slowest mode here has 12.5 frames a second
/// with exposure stretched to two frames: 160 ms. Tripled, because the light is not known.
pub const FRAME_WITHIN: Duration = Duration::from_millis(480);
/// How often the port is looked at: a tenth of what 8 KB of its memory hold at 6 MHz would be
/// 130 µs; the port holds a whole frame, so a millisecond is soon enough.
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// Frames until exposure and white balance have found the scene after set-up.
const SETTLE_AT_START: u8 = 8;
/// Frames that may still be of the mode before.
const SETTLE_AT_SWITCH: u8 = 2;

/// The parallel port behind the sensor's D2–D9, PCLK, HREF and VSYNC: a camera interface with
/// DMA, which gathers bytes while HREF is high and notes where VSYNC ends a frame.
pub trait PixelPort {
    /// Begins to gather, in the middle of whatever frame is under way. What was gathered before
    /// is dropped.
    fn start(&mut self);

    /// Hands all bytes gathered since the last call to `take`, in order and in pieces; the flag
    /// says that a frame ends after the piece, which may then be empty. Does not wait.
    ///
    /// # Errors
    /// [`Overrun`] when bytes were lost since the last call. The port gathers no more then.
    fn drain(&mut self, take: &mut dyn FnMut(&[u8], bool)) -> Result<(), Overrun>;

    /// Stops gathering.
    fn stop(&mut self);
}

/// A port had to drop bytes: nobody looked for too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Overrun;

/// Why there is no picture. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Error {
    /// Nothing answers at the sensor's address: ribbon or power.
    Absent,
    /// Something answers and is no OV2640; its product number.
    Unknown(u8),
    /// The sensor answers, and sends no frame ends.
    Stalled,
    /// Frames come, and none of them was whole in time.
    Garbled,
    /// The still does not fit the buffer.
    TooLarge,
    /// The buffer is not one frame long.
    Length,
}

impl CameraError for Error {
    fn kind(&self) -> CameraErrorKind {
        match self {
            Self::Absent | Self::Unknown(_) => CameraErrorKind::Absent,
            Self::Stalled => CameraErrorKind::Stalled,
            Self::Garbled => CameraErrorKind::Garbled,
            Self::TooLarge => CameraErrorKind::TooLarge,
            Self::Length => CameraErrorKind::Length,
        }
    }
}

/// An OV2640. See the [module](self).
#[derive(Debug)]
pub struct Ov2640<B, P, C> {
    control: Control<B>,
    port: P,
    clock: C,
    format: FrameFormat,
    /// What the sensor is set to; `None` before set-up and after a failure.
    mode: Option<Mode>,
}

impl<B: I2c, P: PixelPort, C: Clock> Ov2640<B, P, C> {
    /// A sensor that has not been spoken to. Does no I/O.
    ///
    /// `format` is that of frames; what this driver does not know is taken for grey.
    pub const fn new(bus: B, port: P, clock: C, format: FrameFormat) -> Self {
        Self {
            control: Control::new(bus),
            port,
            clock,
            format: match format {
                FrameFormat::Rgb565 => FrameFormat::Rgb565,
                _ => FrameFormat::Grey8,
            },
            mode: None,
        }
    }

    /// Takes one picture.
    async fn picture(&mut self, mode: Mode, frame: &mut Frame<'_>) -> Result<usize, Error> {
        let deadline = self.clock.now() + PICTURE_WITHIN;
        let clock = self.clock.clone();
        let taken = with_deadline(&clock, deadline, self.expose(mode, frame)).await;
        self.port.stop();
        let result = taken.unwrap_or(Err(if frame.ends() > 0 {
            Error::Garbled
        } else {
            Error::Stalled
        }));
        if matches!(
            result,
            Err(Error::Absent | Error::Unknown(_) | Error::Stalled | Error::Garbled)
        ) {
            self.mode = None;
        }
        result
    }

    async fn expose(&mut self, mode: Mode, frame: &mut Frame<'_>) -> Result<usize, Error> {
        let mut skip = self.set(mode).await?;
        self.port.start();
        let mut last_end = self.clock.now();
        // The first end closes a frame of which the beginning was missed.
        let mut missed = true;
        loop {
            self.clock.sleep(LOOK_EVERY).await;
            let ends = frame.ends();
            let mut verdict = Verdict::More;
            let drained = self.port.drain(&mut |bytes, end| {
                if verdict == Verdict::More {
                    if !missed && skip == 0 {
                        verdict = frame.take(bytes);
                    }
                    if end {
                        verdict = if missed || skip > 0 {
                            skip = skip.saturating_sub(u8::from(!missed));
                            missed = false;
                            frame.note_end();
                            Verdict::More
                        } else {
                            frame.end(verdict)
                        };
                    }
                }
            });
            match verdict {
                Verdict::Whole(len) => return Ok(len),
                Verdict::TooLarge => return Err(Error::TooLarge),
                Verdict::More => {}
            }
            let now = self.clock.now();
            if drained.is_err() {
                frame.clear();
                missed = true;
                self.port.start();
            }
            if frame.ends() != ends {
                last_end = now;
            } else if now.saturating_since(last_end) >= FRAME_WITHIN {
                return Err(Error::Stalled);
            }
        }
    }

    /// Sets the sensor to `mode`; how many frames to let pass.
    async fn set(&mut self, mode: Mode) -> Result<u8, Error> {
        let skip = match self.mode {
            Some(present) if present == mode => return Ok(0),
            Some(_) => SETTLE_AT_SWITCH,
            None => {
                self.control.reset(&self.clock).await?;
                SETTLE_AT_START
            }
        };
        // Half set is not set.
        self.mode = None;
        self.control.select(mode).await?;
        self.mode = Some(mode);
        Ok(skip)
    }

    /// Tells the sensor's product and version numbers (PIDH and PIDL).
    ///
    /// # Errors
    /// [`Error::Absent`] or [`Error::Unknown`].
    ///
    /// # Cancellation Safety
    /// Safe: the next call begins anew.
    pub async fn probe(&mut self) -> Result<(u8, u8), Error> {
        let deadline: Instant = self.clock.now() + FRAME_WITHIN;
        let clock = self.clock.clone();
        with_deadline(&clock, deadline, self.control.probe())
            .await
            .map_err(|_| Error::Absent)?
    }
}

impl<B: I2c, P: PixelPort, C: Clock> Camera for Ov2640<B, P, C> {
    type Error = Error;

    fn size(&self) -> (u16, u16) {
        (FRAME_SIDE, FRAME_SIDE)
    }

    fn format(&self) -> FrameFormat {
        self.format
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), Error> {
        let pixels = usize::from(FRAME_SIDE) * usize::from(FRAME_SIDE);
        let (mode, len) = match self.format {
            FrameFormat::Rgb565 => (Mode::Rgb565, 2 * pixels),
            _ => (Mode::Grey, pixels),
        };
        if frame.len() != len {
            return Err(Error::Length);
        }
        let mut collected = match mode {
            Mode::Grey => Frame::luma_of_yuyv(frame),
            Mode::Rgb565 | Mode::Jpeg => Frame::bytes(frame),
        };
        self.picture(mode, &mut collected).await.map(|_| ())
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, Error> {
        self.picture(Mode::Jpeg, &mut Frame::jpeg(jpeg)).await
    }
}
