//! What the robot would see: a small grey picture of the real geometry.

use crawler_hal::{Camera, Clock, Duration, FrameFormat};
use rand_core::Rng;

use crate::world::{Sight, Surface, Vec2, Wire};

/// Width and height of a frame, in pixels.
pub const CAMERA_SIDE: u16 = 96;

/// Half the horizontal field of view: 30°.
const HALF_VIEW: f32 = core::f32::consts::FRAC_PI_6;
/// Focal length in pixels: 48 / tan 30°.
const FOCAL_PX: f32 = 83.138_44;
/// Height of the lens above the floor, metres.
const EYE_M: f32 = 0.07;
/// How far the camera sees anything but walls, metres.
const SIGHT_M: f32 = 12.0;
/// From the call to the last byte: one frame at 30 a second.
const FRAME_TIME: Duration = Duration::from_micros(33_333);
/// Largest deviation of a pixel by sensor noise, in grey levels.
const NOISE_LEVELS: u32 = 3;

/// A grey camera of 96 × 96 pixels that looks forward from the robot's centre.
#[derive(Debug)]
pub struct SimCamera {
    wire: Wire,
}

/// Why there is no frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CameraError {
    /// The buffer is not exactly one frame long.
    Length,
    /// The body behind this camera was reset or lost its power.
    Disconnected,
}

impl SimCamera {
    pub(crate) const fn new(wire: Wire) -> Self {
        Self { wire }
    }
}

impl Camera for SimCamera {
    type Error = CameraError;

    fn size(&self) -> (u16, u16) {
        (CAMERA_SIDE, CAMERA_SIDE)
    }

    fn format(&self) -> FrameFormat {
        FrameFormat::Grey8
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), CameraError> {
        let side = usize::from(CAMERA_SIDE);
        if frame.len() != side * side {
            return Err(CameraError::Length);
        }
        if !self.wire.is_live() {
            return Err(CameraError::Disconnected);
        }
        self.wire.clock().sleep(FRAME_TIME).await;
        if !self.wire.is_live() {
            return Err(CameraError::Disconnected);
        }
        let ports = &self.wire.ports;
        let mut space = ports.shared.space.borrow_mut();
        space.list_robots(0);
        let eye = space.bodies.pose(ports.index());
        let view = space.in_view(ports.index(), eye, HALF_VIEW, SIGHT_M);
        let mut sights = Vec::new();
        for column in 0..side {
            // Pixels to the right lie clockwise.
            let offset = (side as f32 * 0.5 - column as f32 - 0.5) / FOCAL_PX;
            let stretch = (1.0 + offset * offset).sqrt();
            let ray =
                Vec2::new(1.0 / stretch, offset / stretch).out_of_frame(Vec2::unit(eye.theta));
            sights.clear();
            view.look(eye.position(), ray, &mut sights);
            // Farthest first: the near hide the far where they stand before them.
            sights.sort_by(|a, b| b.distance.total_cmp(&a.distance));
            paint_background(frame, column);
            for sight in &sights {
                paint(frame, column, sight, sight.distance / stretch);
            }
        }
        grain(frame, &mut *ports.camera_rng.borrow_mut());
        Ok(())
    }
}

/// Ceiling above the horizon, floor below it, brighter the nearer it is.
fn paint_background(frame: &mut [u8], column: usize) {
    let side = usize::from(CAMERA_SIDE);
    for row in 0..side {
        let below = row as f32 + 0.5 - side as f32 * 0.5;
        frame[row * side + column] = if below < 0.0 {
            215
        } else {
            let distance = EYE_M * FOCAL_PX / below;
            (70.0 + 60.0 / (1.0 + distance)) as u8
        };
    }
}

/// One upright surface at a distance measured along the optical axis.
fn paint(frame: &mut [u8], column: usize, sight: &Sight, depth: f32) {
    let side = usize::from(CAMERA_SIDE);
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
    let horizon = side as f32 * 0.5;
    let depth = depth.max(1e-3);
    let top = (horizon - (height_m - EYE_M) * FOCAL_PX / depth).clamp(0.0, side as f32);
    let bottom = (horizon + EYE_M * FOCAL_PX / depth).clamp(0.0, side as f32);
    for row in top as usize..bottom as usize {
        frame[row * side + column] = shade;
    }
}

fn grain(frame: &mut [u8], rng: &mut impl Rng) {
    for pixel in frame {
        let noise = rng.next_u32() % (2 * NOISE_LEVELS + 1);
        *pixel = pixel
            .saturating_add(noise as u8)
            .saturating_sub(NOISE_LEVELS as u8);
    }
}
