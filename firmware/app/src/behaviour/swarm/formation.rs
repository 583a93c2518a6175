//! `formation`: one distance to each neighbour, a lattice of triangles.

use crawler_protocol::Pose;

use super::{FAR, add, towards};
use crate::neighbours::Neighbour;

/// Distance between neighbours in `formation`, in metres.
pub const LATTICE: f32 = 0.8;
/// Neighbours farther than this are not next to it in the lattice: less than the √3 sides of a
/// triangle that lead to the one behind.
const LATTICE_REACH: f32 = 1.3 * LATTICE;
/// Pull of a neighbour in the lattice that is too far, as a share of the push of one that is too
/// near: else those around press the ones in the middle together.
const PULL: f32 = 0.3;

pub(super) fn formation(pose: &Pose, near: &[Neighbour]) -> [f32; 2] {
    let mut sum = [0.0; 2];
    let mut nearest: Option<([f32; 2], f32)> = None;
    for other in near {
        let (direction, distance) = towards(pose, other);
        if distance <= LATTICE_REACH {
            let off = (distance - LATTICE) / FAR;
            add(
                &mut sum,
                direction,
                if off > 0.0 { PULL * off } else { off },
            );
        }
        if nearest.is_none_or(|(_, least)| distance < least) {
            nearest = Some((direction, distance));
        }
    }
    match nearest {
        // Nobody is next to it yet: to whoever is nearest.
        Some((direction, distance)) if distance > LATTICE_REACH => {
            direction.map(|along| along * (distance - LATTICE) / FAR)
        }
        Some(_) | None => sum,
    }
}
