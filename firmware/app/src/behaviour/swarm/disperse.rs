//! `disperse`: away from everyone who is too near.

use super::{FULL, Scene};
use crate::motion::angle::length;

/// `disperse` rests when nobody is nearer than this, in metres.
pub const APART: f32 = 1.2;
/// Nearer than this others are moved away from, in millimetres: well before [`APART`] what is left of the wish is
/// too small to move for.
const KEPT_MM: i32 = 1_290;
/// Somebody nearer than that by this makes a robot hurry, in millimetres.
const HURRY_MM: i32 = 500;

/// Wanted velocity, in 1/[`FULL`] of the permitted speed.
pub(super) fn disperse(scene: &Scene<'_>) -> [i32; 2] {
    let mut sum = [0_i32; 2];
    for other in scene.near {
        let Some(other) = scene.other(other) else {
            continue;
        };
        if other.square >= KEPT_MM * KEPT_MM {
            continue;
        }
        let distance = length(other.at);
        // Two in one place are apart by noise alone, so any direction will do.
        let [x, y] = if distance == 0 { [1, 0] } else { other.at };
        let inside = KEPT_MM - distance;
        let distance = distance.max(1);
        sum[0] -= x * inside / distance;
        sum[1] -= y * inside / distance;
    }
    sum.map(|mm| mm * FULL / HURRY_MM)
}
