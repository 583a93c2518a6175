//! `disperse`: away from everyone who is too near.

use crawler_protocol::Pose;

use super::{FAR, add, towards};
use crate::neighbours::Neighbour;

/// `disperse` rests when nobody is nearer than this, in metres.
pub const APART: f32 = 1.2;

pub(super) fn disperse(pose: &Pose, near: &[Neighbour]) -> [f32; 2] {
    let mut sum = [0.0; 2];
    for other in near {
        let (direction, distance) = towards(pose, other);
        let inside = (APART - distance) / FAR;
        if inside > 0.0 {
            add(&mut sum, direction, -inside);
        }
    }
    sum
}
