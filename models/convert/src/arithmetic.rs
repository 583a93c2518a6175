//! Scales as integers, exactly or not at all.

/// The exponent of a power of two.
pub(crate) fn exponent(scale: f32) -> Option<i32> {
    let exponent = f64::from(scale).log2().round() as i32;
    let exact = scale.is_finite() && scale > 0.0 && exp2(exponent) == f64::from(scale);
    exact.then_some(exponent)
}

fn exp2(exponent: i32) -> f64 {
    f64::from(exponent).exp2()
}

/// `m` and `s` of a factor `m / 2^s`: the smallest `s` from 1 to 24 that makes `m` whole.
pub(crate) fn fraction(factor: f64) -> Option<(u8, u8)> {
    (1..=24_u8).find_map(|shift| {
        let multiplier = factor * exp2(i32::from(shift));
        let whole = multiplier.fract() == 0.0 && (1.0..=255.0).contains(&multiplier);
        whole.then_some((multiplier as u8, shift))
    })
}

/// How much two summands and their sum are shifted, given the exponents of their scales and of the
/// output's.
pub(crate) fn lifts(one: i32, other: i32, sum: i32) -> Option<([u8; 2], u8)> {
    // At least one place is taken off at the end, or halves could not be told from wholes.
    let least = one.min(other).min(sum - 1);
    let lift = |exponent: i32| {
        u8::try_from(exponent - least)
            .ok()
            .filter(|lift| *lift <= 12)
    };
    let shift = u8::try_from(sum - least)
        .ok()
        .filter(|shift| *shift <= 24)?;
    Some(([lift(one)?, lift(other)?], shift))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn only_powers_of_two_have_an_exponent() {
        assert_eq!(exponent(0.015_625), Some(-6));
        assert_eq!(exponent(8.0), Some(3));
        for wrong in [0.0, -0.5, 0.3, f32::NAN, f32::INFINITY] {
            assert_eq!(exponent(wrong), None, "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn a_fraction_is_exact(multiplier: u8, shift in 1_u8..=24) {
            prop_assume!(multiplier > 0);
            let factor = f64::from(multiplier) / exp2(i32::from(shift));
            let (m, s) = fraction(factor).unwrap();
            prop_assert!(s <= shift);
            prop_assert_eq!(f64::from(m) / exp2(i32::from(s)), factor);
        }

        #[test]
        fn lifted_summands_and_their_sum_agree(one in -9_i32..3, other in -9_i32..3, sum in -9_i32..3) {
            if let Some((lifts, shift)) = lifts(one, other, sum) {
                for (exponent, lift) in [(one, lifts[0]), (other, lifts[1])] {
                    prop_assert_eq!(exponent - sum, i32::from(lift) - i32::from(shift));
                }
                prop_assert!(shift >= 1);
            }
        }
    }

    #[test]
    fn what_is_no_fraction_is_refused() {
        assert_eq!(fraction(1.0 / 3.0), None);
        assert_eq!(fraction(256.5), None);
        assert_eq!(fraction(0.0), None);
        assert_eq!(lifts(-20, 0, -5), None);
    }
}
