//! `flock`: separation, alignment, cohesion, and on.

use crawler_protocol::Pose;

use super::{add, towards};
use crate::neighbours::Neighbour;

/// `flock` keeps this distance, in metres.
const FLOCK_APART: f32 = 0.6;
/// Weights of separation, alignment, cohesion and going on, in `flock`.
const FLOCK: [f32; 4] = [1.5, 1.0, 0.3, 0.6];

pub(super) fn flock(pose: &Pose, near: &[Neighbour], speed: f32) -> [f32; 2] {
    let [separation, alignment, cohesion, onwards] = FLOCK;
    let mut sum = [0.0; 2];
    add(
        &mut sum,
        [libm::cosf(pose.theta), libm::sinf(pose.theta)],
        onwards,
    );
    let each = 1.0 / (near.len() as f32).max(1.0);
    for other in near {
        let (direction, distance) = towards(pose, other);
        let inside = (FLOCK_APART - distance) / FLOCK_APART;
        if inside > 0.0 {
            add(&mut sum, direction, -separation * inside);
        }
        add(&mut sum, other.velocity, alignment * each / speed.max(0.01));
        add(&mut sum, direction, cohesion * each * distance.min(1.0));
    }
    sum
}
