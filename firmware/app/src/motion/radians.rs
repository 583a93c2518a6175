//! Angles in radians, as estimates and messages have them. [`angle`](super::angle) has them in whole numbers.

use core::f32::consts::PI;

/// The same angle, above −π and up to π.
pub(crate) fn wrap(angle: f32) -> f32 {
    if angle > -PI && angle <= PI {
        return angle;
    }
    let angle = libm::remainderf(angle, 2.0 * PI);
    if angle <= -PI { PI } else { angle }
}

/// Binary places of an angle as a whole number.
const ANGLE_PLACES: u32 = 28;
/// Angles from here on have no room in that: they are brought within a turn first.
const TOO_LARGE: f32 = 8.0;
/// A quarter turn with so many places, 10⁻⁹ too short.
const QUARTER: i32 = 421_657_428;
/// Quarter turns in a radian, with 31 places.
const QUARTERS: i32 = 1_367_130_551;
/// Binary places of sine and cosine.
const PLACES: u32 = 30;

/// Sine and cosine, to 10⁻⁸ and what rounding adds: as good as those of `libm`, which reckons them in double precision
/// and takes five times as long for it on a board without a floating-point unit. No numbers for what is none; of angles of 8
/// and more as exact as [`wrap`].
///
/// In whole numbers: the angle less the nearest quarter turns, and of the rest two polynomials with the coefficients of
/// Moshier's Cephes library (`sinf.c`, 1989), which are off by less than 10⁻⁸ within an eighth of a turn.
pub(crate) fn sin_cos(radians: f32) -> [f32; 2] {
    let angle = if libm::fabsf(radians) < TOO_LARGE {
        radians
    } else {
        let within = wrap(radians);
        if within.is_nan() {
            return [within; 2];
        }
        within
    };
    let angle = whole(angle);
    // Of the product, with 59 places, the upper half.
    let quarters = ((i64::from(angle) * i64::from(QUARTERS)) >> 32) as i32;
    let nearest = (quarters + (1 << 26)) >> 27;
    let x = (angle - nearest * QUARTER) << (PLACES - ANGLE_PLACES);
    let square = product(x, x);
    let sum = -178_956_841 + product(square, 8_946_590 + product(square, -209_544));
    let sin = x + product(x, product(square, sum));
    let sum = 44_739_220 + product(square, -1_491_139 + product(square, 26_235));
    let cos = (1 << PLACES) - square / 2 + product(product(square, square), sum);
    let [sin, cos] = match nearest & 3 {
        0 => [sin, cos],
        1 => [cos, -sin],
        2 => [-sin, -cos],
        _ => [-cos, sin],
    };
    [sin, cos].map(|part| part as f32 * (1.0 / (1_u32 << PLACES) as f32))
}

/// A number below [`TOO_LARGE`] with [`ANGLE_PLACES`] binary places, the rest of which is cut off.
const fn whole(number: f32) -> i32 {
    let bits = number.to_bits();
    let mantissa = (bits & 0x007F_FFFF | 0x0080_0000).cast_signed();
    // By how much its last place is above ours.
    let up = (bits << 1 >> 24).cast_signed() - (127 + 23 - ANGLE_PLACES.cast_signed());
    let size = if up >= 0 {
        mantissa << up
    } else if up > -24 {
        mantissa >> -up
    } else {
        0
    };
    if number < 0.0 { -size } else { size }
}

/// The product of two numbers with [`PLACES`] binary places each, of which it has as many.
const fn product(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> PLACES) as i32
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// How far sine and cosine are from those in double precision.
    fn off(radians: f32) -> f64 {
        let [sin, cos] = sin_cos(radians).map(f64::from);
        let exact = f64::from(radians).sin_cos();
        (sin - exact.0).abs().max((cos - exact.1).abs())
    }

    #[test]
    fn sines_and_cosines_are_those_of_double_precision() {
        // Every 4,099th of all numbers within the range, which are above two thousand million.
        let mut worst = 0.0_f64;
        for bits in (0..TOO_LARGE.to_bits()).step_by(4_099) {
            for radians in [f32::from_bits(bits), -f32::from_bits(bits)] {
                worst = worst.max(off(radians));
            }
        }
        assert!(worst < 4.5e-8, "{worst}");
        assert!(worst > 1e-9, "nothing was compared");
    }

    #[test]
    fn quarter_turns_are_where_they_belong() {
        for quarters in -5..=5_i16 {
            let around = f32::from(quarters) * (PI / 2.0);
            let [sin, cos] = sin_cos(around);
            let whole = [[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]];
            let [exact_sin, exact_cos] = whole[usize::from(quarters.cast_unsigned() & 3)];
            assert!((sin - exact_sin).abs() < 1e-6, "{quarters}: {sin}");
            assert!((cos - exact_cos).abs() < 1e-6, "{quarters}: {cos}");
        }
        assert_eq!(sin_cos(0.0), [0.0, 1.0]);
    }

    #[test]
    fn what_is_no_number_has_none() {
        for radians in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(sin_cos(radians).iter().all(|part| part.is_nan()));
        }
    }

    proptest! {
        #[test]
        fn any_number_has_a_direction(bits: u32) {
            let radians = f32::from_bits(bits);
            prop_assume!(radians.is_finite());
            let [sin, cos] = sin_cos(radians);
            prop_assert!((sin * sin + cos * cos - 1.0).abs() < 1e-6, "{sin} {cos}");
            if libm::fabsf(radians) < 100.0 {
                prop_assert!(off(radians) < 4e-6);
            }
        }
    }
}
