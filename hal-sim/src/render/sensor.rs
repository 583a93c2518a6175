//! What a camera makes of the light that falls into it.

use super::frame::Frame;
use super::noise::scramble;
use crate::world::Look;

/// Most pictures that a blurred one is the mean of.
const MOST_TAPS: i32 = 9;

/// Standard deviation of the difference of two bytes.
const BYTES: f32 = 104.51;

/// How a camera moves while its shutter is open.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Forward, metres per second.
    pub v: f32,
    /// Anticlockwise, radians per second.
    pub w: f32,
}

/// Makes of a clean picture what a camera would have taken. `key` names the picture: another key
/// is other noise.
pub(crate) fn develop(frame: &mut Frame, look: &Look, focal: f32, motion: Motion, key: u64) {
    blur(frame, look.shutter_ms * 1e-3, focal, motion);
    expose(frame, look);
    noise(frame, look, key);
}

/// The mean of what passes a pixel while the shutter is open, around the middle of that time:
/// names and depths stay those of the middle.
fn blur(frame: &mut Frame, open_s: f32, focal: f32, motion: Motion) {
    let (width, height) = (i32::from(frame.width()), i32::from(frame.height()));
    let turned = motion.w * open_s * focal;
    let forward = motion.v * open_s;
    if libm::fabsf(turned) < 0.5 && libm::fabsf(forward) < 1e-4 {
        return;
    }
    let mut sharp = core::mem::take(&mut frame.sharp);
    sharp.clear();
    sharp.extend_from_slice(&frame.rgb);
    for row in 0..height {
        let down = row as f32 + 0.5 - height as f32 * 0.5;
        for column in 0..width {
            let right = column as f32 + 0.5 - width as f32 * 0.5;
            let at = (row * width + column) as usize;
            // What is near grows while one drives towards it.
            let nearing = forward / frame.depth[at].max(0.02);
            let way = [turned + right * nearing, down * nearing];
            let taps = (libm::fabsf(way[0]).max(libm::fabsf(way[1])) + 1.0) as i32;
            let taps = taps.min(MOST_TAPS);
            if taps < 2 {
                continue;
            }
            let mut sums = [0_u32; 3];
            for tap in 0..taps {
                let when = (tap as f32 + 0.5) / taps as f32 - 0.5;
                let near = |place: i32, way: f32, most: i32| {
                    (place + libm::roundf(way * when) as i32).clamp(0, most - 1)
                };
                let from = near(row, way[1], height) * width + near(column, way[0], width);
                let from = 3 * from as usize;
                for (sum, &level) in sums.iter_mut().zip(&sharp[from..from + 3]) {
                    *sum += u32::from(level);
                }
            }
            let taps = taps as u32;
            for (level, sum) in frame.rgb[3 * at..3 * at + 3].iter_mut().zip(sums) {
                *level = ((sum + taps / 2) / taps) as u8;
            }
        }
    }
    frame.sharp = sharp;
}

/// Exposure, white balance and dark corners.
fn expose(frame: &mut Frame, look: &Look) {
    if look.exposure == 1.0 && look.warmth == 0.0 && look.vignette == 0.0 {
        return;
    }
    let gains = [1.0 + look.warmth, 1.0, 1.0 - look.warmth].map(|gain| gain * look.exposure);
    let (width, height) = (usize::from(frame.width()), usize::from(frame.height()));
    let middle = [width, height].map(|size| size as f32 * 0.5);
    let dark = look.vignette / (middle[0] * middle[0] + middle[1] * middle[1]);
    for (row, line) in frame.rgb.chunks_exact_mut(3 * width).enumerate() {
        let down = row as f32 + 0.5 - middle[1];
        for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
            let right = column as f32 + 0.5 - middle[0];
            let light = 1.0 - dark * (right * right + down * down);
            for (level, gain) in pixel.iter_mut().zip(gains) {
                // The cast saturates, as a sensor does.
                *level = (f32::from(*level) * gain * light + 0.5) as u8;
            }
        }
    }
}

/// Noise of light and of the sensor, with a triangular distribution.
fn noise(frame: &mut Frame, look: &Look, key: u64) {
    if look.shot_noise == 0.0 && look.read_noise == 0.0 {
        return;
    }
    let shot = look.shot_noise * look.shot_noise;
    let read = look.read_noise * look.read_noise;
    let deviations: [f32; 256] =
        core::array::from_fn(|level| (read + shot * level as f32).sqrt() / BYTES);
    let seed = scramble(key as u32) ^ scramble(!(key >> 32) as u32);
    for (at, pixel) in frame.rgb.chunks_exact_mut(3).enumerate() {
        let one = scramble(seed ^ at as u32);
        let two = one.wrapping_mul(0x9E37_79B9) ^ (one >> 13);
        let bytes = [one.to_le_bytes(), two.to_le_bytes()];
        let pairs = [
            [bytes[0][0], bytes[0][1]],
            [bytes[0][2], bytes[0][3]],
            [bytes[1][2], bytes[1][3]],
        ];
        for (level, [more, less]) in pixel.iter_mut().zip(pairs) {
            let off = f32::from(i16::from(more) - i16::from(less));
            *level = (f32::from(*level) + off * deviations[usize::from(*level)] + 0.5) as u8;
        }
    }
}
