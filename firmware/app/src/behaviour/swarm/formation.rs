//! `formation`: to the free place of a lattice of triangles that is nearest to its middle.
//!
//! The lattice lies in the coordinates in which others are told, with its middle in the origin: the same for all. A place
//! belongs to whoever is nearest to it. Everyone goes to the free place nearest to the middle among its own and the
//! six around it, and rests when every nearer one is taken. Somebody rests there likewise, down to
//! the middle: the taken places are in one piece and without holes, however many robots there are. When one is
//! lost, others move up. Nobody leads, and nobody has to be told who is who.

use super::{FULL, Scene};

/// Distance between neighbours in `formation`, in metres.
pub const LATTICE: f32 = 0.8;
const LATTICE_MM: i32 = (LATTICE * 1_000.0) as i32;
/// Off its place by this a robot hurries, in millimetres.
const HURRY_MM: i32 = 250;
/// Distances in the lattice are in 1/256 of [`LATTICE`].
const ONE: i32 = 256;
/// Farthest from the middle that is reckoned with, in millimetres.
const FARTHEST_MM: i32 = 100_000;
/// Whoever has the place nearest to a robot, or one of the six around it, is no farther from the robot than that: by
/// the distance of two places, and by how far each of the two can be from its own.
const REACH_MM: i32 = LATTICE_MM * 22 / 10;
/// Steps to a place itself and to those around it.
const AROUND: [Place; 7] = [[0, 0], [1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]];
/// Steps that lead between two of those around.
const BETWEEN: [Place; 6] = [[1, 1], [-1, 2], [-2, 1], [-1, -1], [1, -2], [2, -1]];

/// Numbers of a place along two axes that are 60° apart.
type Place = [i32; 2];

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

/// Number of a step among [`AROUND`]; none of theirs for a longer one.
fn index_of([a, b]: Place) -> usize {
    const INDICES: [[u8; 3]; 3] = [[9, 4, 3], [5, 0, 2], [6, 1, 9]];
    let row = INDICES.get(a.wrapping_add(1) as usize);
    let index = row.and_then(|row| row.get(b.wrapping_add(1) as usize));
    usize::from(index.copied().unwrap_or(9))
}

const fn in_lattice(mm: i32) -> i32 {
    mm * ONE / LATTICE_MM
}

/// The place nearest to a position. Rounded along three axes that add up to nothing: the one that is off
/// most follows from the others.
#[inline]
fn nearest([x, y]: [i32; 2]) -> Place {
    let second = y * ONE / 222;
    let first = x - second / 2;
    let third = -first - second;
    let [near_first, near_second, near_third] =
        [first, second, third].map(|value| (value + ONE / 2) >> 8);
    let off_first = (near_first * ONE - first).abs();
    let off_second = (near_second * ONE - second).abs();
    let off_third = (near_third * ONE - third).abs();
    if off_first > off_second && off_first > off_third {
        [-near_second - near_third, near_second]
    } else if off_second > off_third {
        [near_first, -near_first - near_third]
    } else {
        [near_first, near_second]
    }
}

/// Where a place is. A row is √3/2 above the one below: 14,189 of 1/64 more, so that far rows are not off.
const fn position([a, b]: Place) -> [i32; 2] {
    [a * ONE + b * (ONE / 2), (b * 14_189) >> 6]
}

/// Square of how far a position is from a place near it.
const fn off([x, y]: [i32; 2], place: Place) -> i32 {
    let [to_x, to_y] = position(place);
    (x - to_x) * (x - to_x) + (y - to_y) * (y - to_y)
}

/// Square of the distance from the middle: places are filled in this order.
const fn rank([a, b]: Place) -> i32 {
    a * a + a * b + b * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_have_their_numbers() {
        for (index, step) in AROUND.iter().enumerate() {
            assert_eq!(index_of(*step), index);
        }
        for step in BETWEEN
            .iter()
            .chain(&[[i32::MIN, 0], [0, i32::MAX], [2, 0]])
        {
            assert!(index_of(*step) >= AROUND.len(), "{step:?}");
        }
    }
}
