//! Where in the world something in a picture is.

use core::f32::consts::FRAC_PI_6;

/// The camera as it sits on the robot, calibrated: a pinhole with square pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Half the horizontal field of view, in radians.
    pub half_view: f32,
    /// How far it looks down, in radians.
    pub pitch: f32,
    /// Height above the floor, in metres.
    pub height_m: f32,
    /// Distance in front of the middle of the axle, in metres.
    pub forward_m: f32,
}

impl Default for Lens {
    /// The nominal camera of the simulator: 60° wide, level, 7 cm above the floor, in the middle.
    fn default() -> Self {
        Self {
            half_view: FRAC_PI_6,
            pitch: 0.0,
            height_m: 0.07,
            forward_m: 0.0,
        }
    }
}

impl Lens {
    /// From where the camera heads to the point at shares `x` of the width and `y` of the height of
    /// a picture whose height is `aspect` times its width: radians, positive to the left.
    pub fn bearing(&self, x: f32, y: f32, aspect: f32) -> f32 {
        let [forward, left, _] = self.ray(x, y, aspect);
        libm::atan2f(left, forward)
    }

    /// Where the ray through this point meets the floor, in metres in front of and to the left of
    /// the middle of the axle; `None` when it does not.
    ///
    /// Taken for the middle of a thing that stands on the floor, this is beyond the thing: by a
    /// third of the distance when the thing is half as high as the camera, by as much again when it
    /// is as high. The middle of what is twice as high as the camera is on the horizon.
    pub fn floor(&self, x: f32, y: f32, aspect: f32) -> Option<[f32; 2]> {
        let [forward, left, up] = self.ray(x, y, aspect);
        let reach = self.height_m / -up;
        let place = [self.forward_m + forward * reach, left * reach];
        (up < 0.0 && forward > 0.0 && place.iter().all(|metres| metres.is_finite()))
            .then_some(place)
    }

    /// Its direction: forward, left, up, level with the floor.
    fn ray(&self, x: f32, y: f32, aspect: f32) -> [f32; 3] {
        let scale = libm::tanf(self.half_view);
        let (right, up) = ((2.0 * x - 1.0) * scale, (1.0 - 2.0 * y) * scale * aspect);
        let (sin, cos) = (libm::sinf(self.pitch), libm::cosf(self.pitch));
        [cos + up * sin, -right, up * cos - sin]
    }
}
