//! `formation`: to the free place of a lattice of triangles that is nearest to its middle.
//!
//! The lattice lies in the coordinates in which others are told, with its middle in the origin: the same for all. A place
//! belongs to whoever is nearest to it. Everyone goes to the free place nearest to the middle among its own and the
//! six around it, and rests when every nearer one is taken. Somebody rests there likewise, down to
//! the middle: the taken places are in one piece and without holes, however many robots there are. When one is
//! lost, others move up. Nobody leads, and nobody has to be told who is who.

use super::Scene;

/// Distance between neighbours in `formation`, in metres.
pub const LATTICE: f32 = 0.8;
const LATTICE_MM: i32 = (LATTICE * 1_000.0) as i32;
/// Off its place by this a robot hurries, in metres.
const HURRY: f32 = 0.25;
/// Distances in the lattice are in 1/256 of [`LATTICE`].
const ONE: i32 = 256;
/// Farthest from the middle that is reckoned with, in millimetres.
const FARTHEST_MM: i32 = 100_000;
/// Steps to a place itself and to those around it.
const AROUND: [Place; 7] = [[0, 0], [1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]];
/// Steps that lead between two of those around.
const BETWEEN: [Place; 6] = [[1, 1], [-1, 2], [-2, 1], [-1, -1], [1, -2], [2, -1]];

/// Numbers of a place along two axes that are 60° apart.
type Place = [i32; 2];

/// Wanted velocity, as a share of the permitted speed.
pub(super) fn formation(scene: &Scene<'_>) -> [f32; 2] {
    let own_mm = [scene.pose.x, scene.pose.y]
        .map(|along| super::thousandths(along).clamp(-FARTHEST_MM, FARTHEST_MM));
    let own = own_mm.map(in_lattice);
    let here = nearest(own);
    let places = AROUND.map(|[a, b]| [here[0] + a, here[1] + b]);
    let offs = places.map(|place| off(own, place));
    let mut taken = [false; AROUND.len()];
    for other in scene.others() {
        let at = [own_mm[0] + other.at[0], own_mm[1] + other.at[1]].map(in_lattice);
        let its = nearest(at);
        for ((place, own_off), taken) in places.iter().zip(offs).zip(&mut taken) {
            *taken |= *place == its && off(at, its) < own_off;
        }
    }
    let to = (0..AROUND.len())
        .filter(|index| !taken[*index])
        // Who has none goes to the nearest one first: another may be behind somebody.
        .min_by_key(|index| {
            let rank = if taken[0] { 0 } else { rank(places[*index]) };
            (rank, offs[*index])
        });
    let [x, y] = if let Some(index) = to {
        let [x, y] = position(places[index]);
        [x - own[0], y - own[1]]
    } else {
        // Outwards, between those who have places.
        let outwards = |step: &Place| rank([here[0] + step[0], here[1] + step[1]]);
        position(BETWEEN.into_iter().max_by_key(outwards).unwrap_or_default())
    };
    let scale = LATTICE / ONE as f32 / HURRY;
    [x as f32 * scale, y as f32 * scale]
}

const fn in_lattice(mm: i32) -> i32 {
    mm * ONE / LATTICE_MM
}

/// The place nearest to a position. Rounded along three axes that add up to nothing: the one that is off
/// most follows from the others.
fn nearest([x, y]: [i32; 2]) -> Place {
    let second = y * ONE / 222;
    let first = x - second / 2;
    let third = -first - second;
    let round = |value: i32| (value + ONE / 2) >> 8;
    let off = |value: i32| (round(value) * ONE - value).abs();
    let [near_first, near_second, near_third] = [first, second, third].map(round);
    if off(first) > off(second) && off(first) > off(third) {
        [-near_second - near_third, near_second]
    } else if off(second) > off(third) {
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
