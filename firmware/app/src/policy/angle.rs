//! Directions in whole numbers.

use core::f32::consts::TAU;

/// Sine of a quarter turn in 64 steps, in 2⁻¹⁴.
const QUARTER: [i16; 65] = {
    let mut table = [0; 65];
    let mut step = 0;
    while step < 65 {
        // The series to the ninth order: off by less than a tenth of a step at a quarter turn.
        let x = step as f64 * core::f64::consts::FRAC_PI_2 / 64.0;
        let square = x * x;
        let sine = x
            * (1.0
                - square / 6.0
                    * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))));
        table[step] = (sine * 16_384.0 + 0.5) as i16;
        step += 1;
    }
    table
};

/// A direction as part of a turn, in 2⁻¹⁶, counter-clockwise from the x axis. What is no number is 0.
pub(super) fn turns(radians: f32) -> u16 {
    (radians * (65_536.0 / TAU)) as i32 as u16
}

/// Cosine and sine of `turns`, in 2⁻¹⁴.
pub(super) fn direction(turns: u16) -> [i32; 2] {
    [sine(turns.wrapping_add(0x4000)), sine(turns)]
}

fn sine(turns: u16) -> i32 {
    let within = turns & 0x3FFF;
    let within = if turns & 0x4000 == 0 {
        within
    } else {
        0x4000 - within
    };
    let (step, part) = (usize::from(within >> 8), i32::from(within & 0xFF));
    let at = |step: usize| i32::from(QUARTER.get(step).copied().unwrap_or(0));
    let sine = if part == 0 {
        at(step)
    } else {
        at(step) + (((at(step + 1) - at(step)) * part) >> 8)
    };
    if turns & 0x8000 == 0 { sine } else { -sine }
}

/// The sector of twelve in which a direction lies; 0 is ahead, then counter-clockwise. What is nowhere is in some.
pub(super) fn sector([x, y]: [i32; 2]) -> usize {
    let (along, across) = (i64::from(x.abs()), i64::from(y.abs()));
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
    fn all_directions_are_right_to_a_thousandth() {
        for turns in 0..=u16::MAX {
            let radians = f64::from(turns) * core::f64::consts::TAU / 65_536.0;
            let [cosine, sine] = direction(turns).map(|part| f64::from(part) / 16_384.0);
            assert!((cosine - libm::cos(radians)).abs() < 1e-3, "{turns}");
            assert!((sine - libm::sin(radians)).abs() < 1e-3, "{turns}");
        }
        assert_eq!(turns(f32::NAN), 0);
        assert_eq!(turns(core::f32::consts::FRAC_PI_2), 0x4000);
        assert_eq!(turns(-core::f32::consts::FRAC_PI_2), 0xC000);
    }

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
        assert!(sector([i32::MIN + 1, i32::MAX]) < 12);
    }
}
