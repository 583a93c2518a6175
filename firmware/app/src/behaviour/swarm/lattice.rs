//! A lattice of triangles: its places, and which is nearest.

/// Distances in the lattice are in 1/256 of what is between two neighbours.
pub(in crate::behaviour) const ONE: i32 = 256;
/// Steps to a place itself and to those around it.
pub(in crate::behaviour) const AROUND: [Place; 7] =
    [[0, 0], [1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]];
/// Steps that lead between two of those around.
pub(in crate::behaviour) const BETWEEN: [Place; 6] =
    [[1, 1], [-1, 2], [-2, 1], [-1, -1], [1, -2], [2, -1]];

/// Numbers of a place along two axes that are 60° apart.
pub(in crate::behaviour) type Place = [i32; 2];

/// Number of a step among [`AROUND`]; none of theirs for a longer one.
pub(in crate::behaviour) fn index_of([a, b]: Place) -> usize {
    const INDICES: [[u8; 3]; 3] = [[9, 4, 3], [5, 0, 2], [6, 1, 9]];
    let row = INDICES.get(a.wrapping_add(1) as usize);
    let index = row.and_then(|row| row.get(b.wrapping_add(1) as usize));
    usize::from(index.copied().unwrap_or(9))
}

/// The place nearest to a position. Rounded along three axes that add up to nothing: the one that is off
/// most follows from the others.
#[inline]
pub(in crate::behaviour) fn nearest([x, y]: [i32; 2]) -> Place {
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
pub(in crate::behaviour) const fn position([a, b]: Place) -> [i32; 2] {
    [a * ONE + b * (ONE / 2), (b * 14_189) >> 6]
}

/// Square of how far a position is from a place near it.
pub(in crate::behaviour) const fn off([x, y]: [i32; 2], place: Place) -> i32 {
    let [to_x, to_y] = position(place);
    (x - to_x) * (x - to_x) + (y - to_y) * (y - to_y)
}

/// Square of the distance from the middle: places are filled in this order.
pub(in crate::behaviour) const fn rank([a, b]: Place) -> i32 {
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
