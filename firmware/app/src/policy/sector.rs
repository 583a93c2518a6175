//! Parts of what is around a robot.

/// How many there are; the first one is ahead, then counter-clockwise.
pub(super) const SECTORS: usize = 12;

/// The sector in which a direction lies, of coordinates up to 2,000,000; 0 is ahead, then counter-clockwise. What is
/// nowhere is in some.
pub(super) const fn sector([x, y]: [i32; 2]) -> usize {
    let (along, across) = (x.abs(), y.abs());
    // Tangents of 15°, 45° and 75°, in thousandths.
    let quarter = if across * 1_000 < along * 268 {
        0
    } else if across < along {
        1
    } else if across * 268 < along * 1_000 {
        2
    } else {
        3
    };
    match (x >= 0, y >= 0) {
        (true, true) => quarter,
        (false, true) => 6 - quarter,
        (false, false) => 6 + quarter,
        (true, false) => (12 - quarter) % 12,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_go_round_in_steps_of_thirty_degrees() {
        for tenth in 0..3_600_u32 {
            let radians = f64::from(tenth) * core::f64::consts::PI / 1_800.0;
            let place = [libm::cos(radians), libm::sin(radians)].map(|part| (part * 1e5) as i32);
            // Right at a border either is right.
            if tenth % 300 != 150 {
                let expected = ((tenth + 150) / 300 % 12) as usize;
                assert_eq!(sector(place), expected, "{tenth}");
            }
        }
        assert_eq!(sector([0, 0]), 3, "nowhere is somewhere");
        assert_eq!(sector([-2_000_000, 2_000_000]), 4);
    }
}
