//! `gather`: to the middle of those in sight.

use crawler_protocol::Pose;

use super::{FAR, add, towards};
use crate::neighbours::Neighbour;

/// `gather` rests when somebody is nearer than this, in metres. A body has 0.16 m across, and the
/// critical distance of 0.15 m lies between two of them.
pub const BESIDE: f32 = 0.42;

pub(super) fn gather(pose: &Pose, near: &[Neighbour]) -> [f32; 2] {
    let mut middle = [pose.x, pose.y];
    let mut nearest = f32::INFINITY;
    for other in near {
        add(&mut middle, [other.x, other.y], 1.0);
        nearest = nearest.min(towards(pose, other).1);
    }
    if nearest <= BESIDE {
        return [0.0; 2];
    }
    let count = near.len() as f32 + 1.0;
    let middle = middle.map(|sum| sum / count);
    [(middle[0] - pose.x) / FAR, (middle[1] - pose.y) / FAR]
}
