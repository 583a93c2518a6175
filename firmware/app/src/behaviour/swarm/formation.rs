//! `formation`: to the free place of a lattice of triangles that is nearest to its middle.
//!
//! The lattice lies in the coordinates in which others are told, with its middle in the origin: the same for all. A place
//! belongs to whoever is nearest to it. Everyone goes to the free place nearest to the middle among its own and the
//! six around it, and rests when every nearer one is taken. Somebody rests there likewise, down to
//! the middle: the taken places are in one piece and without holes, however many robots there are. When one is
//! lost, others move up. Nobody leads, and nobody has to be told who is who.

use super::lattice::{AROUND, BETWEEN, ONE, Place, index_of, nearest, off, position, rank};
use super::{FULL, Scene};

/// Distance between neighbours in `formation`, in metres.
pub const LATTICE: f32 = 0.8;
const LATTICE_MM: i32 = (LATTICE * 1_000.0) as i32;
/// Off its place by this a robot hurries, in millimetres.
const HURRY_MM: i32 = 250;
/// Farthest from the middle that is reckoned with, in millimetres.
const FARTHEST_MM: i32 = 100_000;
/// Whoever has the place nearest to a robot, or one of the six around it, is no farther from the robot than that: by
/// the distance of two places, and by how far each of the two can be from its own.
const REACH_MM: i32 = LATTICE_MM * 22 / 10;
/// Wanted velocity, in 1/[`FULL`] of the permitted speed.
pub(super) fn formation(scene: &Scene<'_>) -> [i32; 2] {
    let own_mm = scene
        .here
        .at
        .map(|along| along.clamp(-FARTHEST_MM, FARTHEST_MM));
    let own = own_mm.map(in_lattice);
    let here = nearest(own);
    let places = AROUND.map(|[a, b]| [here[0] + a, here[1] + b]);
    let offs = places.map(|place| off(own, place));
    let mut taken = [false; AROUND.len()];
    for other in scene.near {
        let Some(other) = scene.other(other) else {
            continue;
        };
        // Whose place is none of the seven.
        if other.square > REACH_MM * REACH_MM {
            continue;
        }
        let at = [own_mm[0] + other.at[0], own_mm[1] + other.at[1]].map(in_lattice);
        let its = nearest(at);
        let index = index_of([its[0] - here[0], its[1] - here[1]]);
        if let (Some(taken), Some(own_off)) = (taken.get_mut(index), offs.get(index)) {
            *taken |= off(at, its) < *own_off;
        }
    }
    // Who has none goes to the nearest one first: another may be behind somebody.
    let homeless = taken[0];
    let mut best: Option<(i32, i32, Place)> = None;
    for ((place, off), taken) in places.iter().zip(&offs).zip(&taken) {
        let rank = if homeless { 0 } else { rank(*place) };
        if !taken && best.is_none_or(|(least, nearest, _)| (rank, *off) < (least, nearest)) {
            best = Some((rank, *off, *place));
        }
    }
    let [x, y] = if let Some((_, _, place)) = best {
        let [x, y] = position(place);
        [x - own[0], y - own[1]]
    } else {
        // Outwards, between those who have places.
        let outwards = |step: &Place| rank([here[0] + step[0], here[1] + step[1]]);
        position(BETWEEN.into_iter().max_by_key(outwards).unwrap_or_default())
    };
    [x, y].map(|along| along * (FULL * LATTICE_MM / ONE) / HURRY_MM)
}

const fn in_lattice(mm: i32) -> i32 {
    mm * ONE / LATTICE_MM
}
