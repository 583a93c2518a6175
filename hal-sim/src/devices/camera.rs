//! What the robot would see: small grey pictures of the real geometry.

use crawler_hal::{Camera, CameraError, CameraErrorKind, Clock, Duration, FrameFormat};
use rand_core::Rng;

use crate::faults::CameraFault;
use crate::world::{Sight, Surface, Vec2, Wire};

/// Width and height of a frame, in pixels.
pub const CAMERA_SIDE: u16 = 96;
/// Width and height of a still, in pixels.
pub const STILL_SIZE: (u16, u16) = (320, 240);

/// Half the horizontal field of view: 30°.
const HALF_VIEW: f32 = core::f32::consts::FRAC_PI_6;
/// Focal length, in widths of the picture: 1 / (2 tan 30°).
const FOCAL: f32 = 0.866_025_4;
/// Height of the lens above the floor, metres.
const EYE_M: f32 = 0.07;
/// How far the camera sees anything but walls, metres.
const SIGHT_M: f32 = 12.0;
/// From the call to the last byte: one frame at 30 a second.
const FRAME_TIME: Duration = Duration::from_micros(33_333);
/// A still takes a change of mode, and frames until exposure has settled.
const STILL_TIME: Duration = Duration::from_millis(250);
/// How long a driver asks a sensor that is not there.
const ABSENT_AFTER: Duration = Duration::from_millis(5);
/// Largest deviation of a pixel by sensor noise, in grey levels.
const NOISE_LEVELS: u32 = 3;
/// Quality of stills, 1 to 100.
const QUALITY: u8 = 75;

/// A grey camera that looks forward from the robot's centre: frames of 96 × 96 pixels, stills of
/// 320 × 240.
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

    fn render(&self, picture: &mut Picture<'_>) {
        let ports = &self.wire.ports;
        let mut space = ports.shared.space.borrow_mut();
        space.list_robots(0);
        let eye = space.bodies.pose(ports.index());
        let view = space.in_view(ports.index(), eye, HALF_VIEW, SIGHT_M);
        let mut sights = Vec::new();
        for column in 0..picture.width {
            // Pixels to the right lie clockwise.
            let offset = (picture.width as f32 * 0.5 - column as f32 - 0.5) / picture.focal();
            let stretch = (1.0 + offset * offset).sqrt();
            let ray =
                Vec2::new(1.0 / stretch, offset / stretch).out_of_frame(Vec2::unit(eye.theta));
            sights.clear();
            view.look(eye.position(), ray, &mut sights);
            // Farthest first: the near hide the far where they stand before them.
            sights.sort_by(|a, b| b.distance.total_cmp(&a.distance));
            picture.paint_background(column);
            for sight in &sights {
                picture.paint(column, sight, sight.distance / stretch);
            }
        }
        picture.grain(&mut *ports.camera_rng.borrow_mut());
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
        FrameFormat::Grey8
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), LensError> {
        let side = usize::from(CAMERA_SIDE);
        if frame.len() != side * side {
            return Err(LensError::Length);
        }
        match self.expose(FRAME_TIME).await? {
            Signal::Garbage => self.fill_with_noise(frame),
            Signal::Picture => self.render(&mut Picture {
                width: side,
                height: side,
                pixels: frame,
            }),
        }
        Ok(())
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, LensError> {
        if let Signal::Garbage = self.expose(STILL_TIME).await? {
            self.fill_with_noise(jpeg);
            return Ok(jpeg.len());
        }
        let (width, height) = STILL_SIZE;
        let mut pixels = vec![0; usize::from(width) * usize::from(height)];
        self.render(&mut Picture {
            width: usize::from(width),
            height: usize::from(height),
            pixels: &mut pixels,
        });
        let mut encoded = Vec::new();
        // Only sizes of zero cannot be encoded, and a `Vec` takes every byte.
        jpeg_encoder::Encoder::new(&mut encoded, QUALITY)
            .encode(&pixels, width, height, jpeg_encoder::ColorType::Luma)
            .map_err(|_| LensError::TooLarge)?;
        let target = jpeg.get_mut(..encoded.len()).ok_or(LensError::TooLarge)?;
        target.copy_from_slice(&encoded);
        Ok(encoded.len())
    }
}

/// Grey pixels, row by row.
struct Picture<'a> {
    width: usize,
    height: usize,
    pixels: &'a mut [u8],
}

impl Picture<'_> {
    /// Focal length in pixels.
    fn focal(&self) -> f32 {
        self.width as f32 * FOCAL
    }

    /// Ceiling above the horizon, floor below it, brighter the nearer it is.
    fn paint_background(&mut self, column: usize) {
        for row in 0..self.height {
            let below = row as f32 + 0.5 - self.height as f32 * 0.5;
            self.pixels[row * self.width + column] = if below < 0.0 {
                215
            } else {
                let distance = EYE_M * self.focal() / below;
                (70.0 + 60.0 / (1.0 + distance)) as u8
            };
        }
    }

    /// One upright surface at a distance measured along the optical axis.
    fn paint(&mut self, column: usize, sight: &Sight, depth: f32) {
        let (height_m, grey) = match sight.of {
            // Panels of half a metre, every other one darker, so that a wall shows its motion.
            Surface::Wall => (
                0.30,
                if (sight.along * 2.0) as i32 % 2 == 0 {
                    185.0
                } else {
                    160.0
                },
            ),
            Surface::Obstacle => (0.25, 120.0),
            Surface::Robot => (0.12, 45.0),
        };
        let light = (0.45 + 0.55 * sight.facing) / (1.0 + 0.08 * sight.distance);
        let shade = (grey * light).clamp(0.0, 255.0) as u8;
        let horizon = self.height as f32 * 0.5;
        let depth = depth.max(1e-3);
        let lowest = self.height as f32;
        let top = (horizon - (height_m - EYE_M) * self.focal() / depth).clamp(0.0, lowest);
        let bottom = (horizon + EYE_M * self.focal() / depth).clamp(0.0, lowest);
        for row in top as usize..bottom as usize {
            self.pixels[row * self.width + column] = shade;
        }
    }

    fn grain(&mut self, rng: &mut impl Rng) {
        for pixel in &mut *self.pixels {
            let noise = rng.next_u32() % (2 * NOISE_LEVELS + 1);
            *pixel = pixel
                .saturating_add(noise as u8)
                .saturating_sub(NOISE_LEVELS as u8);
        }
    }
}
